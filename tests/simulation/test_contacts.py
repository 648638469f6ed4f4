"""Planned contacts, and how early or late feet touch down; how a base follows its command."""

from types import SimpleNamespace

import numpy as np
import pytest

from piaffe.models.quantities import base
from piaffe.simulation import Touchdown, planned_contacts
from piaffe.simulation.contacts import touchdowns
from piaffe.simulation.plan_velocity import planned_velocity
from piaffe.simulation.tracking import heading, in_heading, tracked
from tests.simulation.plans import BODY


def found(planned: str, loaded: str, step: float = 0.01) -> list[float | None]:
    """Return how late the touchdowns of one foot are [steps]."""
    table = np.array([{"1": 1.0, "0": 0.0, "?": np.nan}[flag] for flag in planned])[:, None]
    times = step * np.arange(len(planned))
    made = touchdowns(times, table, np.array([flag == "1" for flag in loaded])[:, None], ("FL",))
    assert all(each.foot == "FL" for each in made)
    return [None if each.late is None else round(each.late / step, 6) for each in made]


@pytest.mark.parametrize(
    ("planned", "loaded", "late"),
    [
        ("1110000011111", "1110000011111", [0]),
        ("1110000011111", "1110000000011", [3]),
        ("1110000011111", "1110001111111", [-2]),
        ("1110000011111", "1110000000000", [None]),  # never in the stance
        ("1110000011111", "1111111111111", [None]),  # it did not leave the ground
        ("1110000011100000011", "1110000001100000110", [1, -1]),
        ("0000011111", "0000001111", [1]),
        ("1111111111", "1100000111", []),  # no touchdown is planned
        ("?????011111", "11111000111", [2]),
        ("??????11111", "11111000111", []),
        ("11100000000011111", "11100001000011111", [0]),  # the foot touches in its swing, and leaves again
    ],
)  # fmt: skip
def test_a_touchdown_is_early_late_or_absent(planned: str, loaded: str, late: list[float | None]) -> None:
    assert found(planned, loaded) == late


def test_a_short_time_off_the_ground_is_a_bounce() -> None:
    planned = "111" + 12 * "0" + "11111"
    assert found(planned, "111" + 9 * "0" + "110" + "11111", step=0.002) == [-3]  # 2 ms off the ground
    assert found(planned, "111" + 5 * "0" + "11" + 4 * "0" + "111111", step=0.002) == [-7]  # 8 ms
    assert found(planned, "111" + 5 * "0" + "1" + 5 * "0" + "111111", step=0.002) == [-1]  # 10 ms
    assert found(planned, "111" + 4 * "0" + "1" + 6 * "0" + "111111", step=0.002) == [-1]  # a bounce before it leaves


def test_times_are_the_plans_and_feet_have_names() -> None:
    planned = np.array([[1, 0], [0, 0], [0, 1], [1, 1], [1, 1]], dtype=float)
    loaded = np.array([[1, 0], [0, 0], [0, 0], [1, 1], [1, 1]], dtype=bool)
    made = touchdowns(0.01 * np.arange(5) + 2.0, planned, loaded, ("FL", "FR"))
    assert made == (Touchdown("FR", 2.02, pytest.approx(0.01)), Touchdown("FL", 2.03, 0.0))


def phase(start: float, flags: list[list[float]], vx: float = 0.0) -> SimpleNamespace:
    """Return a phase with a stage of 10 ms per row of flags."""
    n = len(flags)
    p = np.zeros((n, 7))
    p[:, 2:6] = flags
    states = np.tile(BODY.state(joints="stand", linear_velocity=(vx, 0, 0)), (n + 1, 1))
    mode = SimpleNamespace(layout=SimpleNamespace(slots={"contact": slice(2, 6)}), state=BODY.state)
    return SimpleNamespace(times=start + 0.01 * np.arange(n + 1), p=p, mode=mode, states=states)


def test_planned_contacts_are_those_of_the_stage_at_a_time() -> None:
    plan = SimpleNamespace(phases=[phase(1.0, [[1, 1, 1, 1], [1, 0, 1, 1]]), phase(1.02, [[0, 0, 0, 0], [0, 0, 0, 1]])])
    for contacts in (planned_contacts(SimpleNamespace(), plan), planned_contacts(SimpleNamespace(plan=plan))):
        assert contacts is not None
        for t, flags in (
            (0.0, "1111"),
            (1.0099, "1111"),
            (1.01, "1011"),
            (1.02, "0000"),
            (1.03, "0001"),
            (9.0, "0001"),
        ):
            assert "".join(str(int(flag)) for flag in contacts(t)) == flags


def test_methods_come_before_phases_and_a_plan_without_contacts_has_none() -> None:
    plan = SimpleNamespace(phases=[phase(0.0, [[1, 1, 1, 1]])], contacts=lambda t: [0, 0, 0, 1])
    low = SimpleNamespace(contacts=lambda t: [t > 1, 0, 0, 0])
    first, second = planned_contacts(low, plan), planned_contacts(SimpleNamespace(), plan)
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first(2.0), [1, 0, 0, 0])
    np.testing.assert_array_equal(second(2.0), [0, 0, 0, 1])
    assert planned_contacts(SimpleNamespace()) is None
    assert planned_contacts(SimpleNamespace(), SimpleNamespace(phases=[])) is None
    other = SimpleNamespace(mode=SimpleNamespace(layout=SimpleNamespace(slots={})))
    assert planned_contacts(SimpleNamespace(), SimpleNamespace(phases=[other])) is None
    head = planned_contacts(SimpleNamespace(), SimpleNamespace(phases=[*plan.phases, other]))
    assert head is not None
    np.testing.assert_array_equal(head(9.0), [1, 1, 1, 1])


def test_tracking_is_in_heading_axes() -> None:
    times = np.linspace(0.0, 20.0, 2001)
    rate, ahead, left = 0.7, 0.5, 0.1  # more than two turns, on a circle
    yaw = 0.3 + rate * times
    states = np.array([BODY.state(joints="stand", rpy=(0.1, -0.2, angle)) for angle in yaw[::10]])
    turns = heading(states[:, BODY.state.slices[base.orientation]])
    np.testing.assert_allclose(turns - turns[0], yaw[::10] - yaw[0], atol=1e-9)
    c, s = np.cos(yaw), np.sin(yaw)
    world = np.stack([ahead * c - left * s, ahead * s + left * c, 0 * c], axis=1)
    np.testing.assert_allclose(in_heading(yaw, world), np.tile([ahead, left], (2001, 1)), atol=1e-12)
    made = tracked(times, yaw, in_heading(yaw, world), np.tile([0.6, 0.0, 0.5], (2001, 1)))
    assert made.yaw_rate == pytest.approx(0.7)
    assert made.yaw_rate_error == pytest.approx(0.2)
    assert made.speed == pytest.approx(0.5)  # in the direction of the command
    assert made.speed_error == pytest.approx(0.1 / 0.6)
    assert made.rms_velocity == pytest.approx(np.hypot(0.1, 0.1))
    still = tracked(times, yaw, in_heading(yaw, world), np.zeros((2001, 3)))
    assert np.isnan(still.speed_error)
    assert still.speed == pytest.approx(np.hypot(0.5, 0.1))


def test_the_velocity_of_a_plan_is_interpolated_in_its_phases() -> None:
    flags = [[1.0, 1, 1, 1]]
    plan = SimpleNamespace(phases=[phase(0.0, flags, vx=0.2), phase(0.01, flags, vx=0.6)])
    plan.phases[0].states[1, BODY.state.slices[base.linear_velocity]] = (0.4, 0.0, 0.0)
    made = planned_velocity(plan, np.array([0.0, 0.005, 0.0099, 0.01, 0.5]))
    np.testing.assert_allclose(made[:, 0], [0.2, 0.3, 0.398, 0.6, 0.6])
    np.testing.assert_allclose(made[:, 1:], 0.0, atol=1e-12)
    assert np.isnan(planned_velocity(None, np.zeros(2))).all()
