"""Departures from a plan, of runs written down by hand."""

import numpy as np
import pytest

from piaffe.simulation import Deviation, PolicyRun
from piaffe.simulation.deviation import deviations

FEET, JOINTS, PHASES = ("A", "B"), ("hip", "knee"), ("stand", "fly", "land")
T = 300
PLAN = np.repeat([True, False, True], 100)  # stand, fly and land for 0.1 s each


def found(
    on: np.ndarray, *, plan: np.ndarray = PLAN, slips: np.ndarray | None = None, **changes: object
) -> list[tuple[str, str, float, str, float]]:
    """Return the deviations of a run in which foot A is loaded where ``on`` is true, and foot B as planned."""
    n = len(on)
    forces = np.zeros((n, 2, 3))
    forces[:, 0, 2], forces[:, 1, 2] = np.where(on, 20.0, 0.5), np.where(plan[:n], 20.0, 0.0)
    values: dict[str, object] = {
        "times": 1.0 + 1e-3 * np.arange(n), "states": np.zeros((n, 1)), "planned": np.zeros((n, 1)),
        "phases": np.repeat([0, 1, 2], 100)[:n], "forces": forces,
        "slips": np.zeros((n, 2)) if slips is None else slips, "touching": ((),) * n, "position": np.zeros(n),
        "orientation": np.zeros(n), "full": np.zeros((n, 2), dtype=bool), "lost_at": None, "duration": 0.3,
        "saturated": 0.0, **changes,
    }  # fmt: skip
    run = PolicyRun(**values)  # type: ignore[arg-type]
    made = deviations(run, np.column_stack([plan, plan])[:n], PHASES, FEET, JOINTS, 1.0)
    return [(d.what, d.name, round(d.time, 6), d.phase, round(d.amount, 6)) for d in made]


def flipped(*stretches: tuple[int, int]) -> np.ndarray:
    """Return the plan's contacts, inverted in some stretches."""
    on = PLAN.copy()
    for first, last in stretches:
        on[first:last] = ~on[first:last]
    return on


def test_a_run_as_planned_has_none() -> None:
    assert found(PLAN) == []


@pytest.mark.parametrize(
    ("stretch", "expected"),
    [
        ((180, 200), ("early", "A", 1.18, "fly", 0.020)),
        ((200, 230), ("late", "A", 1.2, "land", 0.030)),
        ((200, 300), ("absent", "A", 1.2, "land", 0.100)),
        ((230, 245), ("lifted", "A", 1.23, "land", 0.015)),
        ((40, 60), ("lifted", "A", 1.04, "stand", 0.020)),
        ((0, 15), ("lifted", "A", 1.0, "stand", 0.015)),  # no touchdown is planned there, so none is late
        ((80, 100), ("lifted", "A", 1.08, "stand", 0.020)),
        ((100, 125), ("stuck", "A", 1.1, "fly", 0.025)),
    ],
)
def test_a_contact_at_another_time_is_named(stretch: tuple[int, int], expected: tuple[object, ...]) -> None:
    assert found(flipped(stretch)) == [expected]


def test_differences_below_ten_milliseconds_are_not_reported() -> None:
    assert found(flipped((192, 200), (100, 109), (230, 239), (20, 29))) == []


def test_a_touch_in_the_middle_of_a_swing_counts_to_the_planned_touchdown() -> None:
    assert found(flipped((140, 150))) == [("early", "A", 1.14, "fly", 0.06)]


def test_of_several_losses_of_contact_in_a_stance_the_longest_is_told() -> None:
    assert found(flipped((220, 232), (250, 275))) == [("lifted", "A", 1.25, "land", 0.025)]


def test_a_foot_that_should_begin_in_the_air_lifts_off_from_nowhere() -> None:
    on = ~PLAN
    on[:30] = True  # on the ground at the start, where the plan has no liftoff
    assert found(on, plan=~PLAN) == []


def test_slips_add_up_over_a_stance_and_only_under_load() -> None:
    slips = np.zeros((T, 2))
    slips[210:250, 1] = 5e-4  # 20 mm
    slips[110:190, 1] = 1.0  # in the air
    assert found(PLAN, slips=slips) == [("slipped", "B", 1.229, "land", 0.02)]


def test_collisions_and_full_torques_are_named() -> None:
    touching = tuple(("knee hull",) if 150 <= i < 160 else () for i in range(T))
    full = np.zeros((T, 2), dtype=bool)
    full[220:250, 0] = True
    full[220:235, 1] = True  # too short to be told
    assert found(PLAN, touching=touching, full=full) == [
        ("collided", "knee", 1.15, "fly", 0.01), ("saturated", "hip", 1.22, "land", 0.03),
    ]  # fmt: skip


def test_a_run_that_ends_before_the_touchdown_has_no_late_one() -> None:
    assert found(PLAN[:150]) == []
    assert found(flipped((200, 250))[:230]) == [("absent", "A", 1.2, "land", 0.03)]


def test_a_deviation_is_a_sentence() -> None:
    assert str(Deviation("early", "FL", 0.2, "fly", 0.0234)) == "FL touched down 23 ms early"
    assert str(Deviation("slipped", "HR", 0.2, "land", 0.0316)) == "HR slipped 32 mm"
    assert str(Deviation("collided", "base", 0.2, "land", 0.005)) == "base touched the ground for 5 ms"
    assert Deviation("saturated", "FL_KFE", 0.2, "land", 0.04).size == pytest.approx(2.0)
