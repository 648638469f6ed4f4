"""A controller along an endless motion: neither time nor memory grows with the time of a plan."""

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.models.gaits.footsteps import ContactSchedule
from piaffe.ocp import Nodes
from piaffe.ocp.language.path import _PhasesByTime
from piaffe.ocp.language.piece import placed_phases

LATE = 1e6  # [s]; eleven days


@pytest.fixture(scope="module")
def problem() -> ocp.Problem:
    robot = models.load("solo12")
    model = models.Mujoco(robot)
    objective = ocp.Objective(ocp.track(models.base.position), ocp.track(models.base.height))
    return ocp.Problem(models.gaits.trot(0.3), model.over(0.2, dt=0.02), objective, initial=model.state(joints="stand"))


def calls(work: Callable[[], object]) -> int:
    """Return the number of Python calls of some work."""
    count = 0

    def heard(frame: Any, event: str, argument: object) -> None:
        nonlocal count
        count += event == "call"

    sys.setprofile(heard)
    try:
        work()
    finally:
        sys.setprofile(None)
    return count


def test_a_late_node_takes_as_many_steps_as_one_soon_after_the_start(problem: ocp.Problem) -> None:
    late, soon = Nodes(problem), Nodes(problem)
    # not from 0 on: the numbers of the first nodes are there from the start
    assert calls(lambda: late.running(round(LATE / late.dt), 10)) < 1.5 * calls(lambda: soon.running(100, 10))


def test_what_is_kept_does_not_grow_along_the_motion(problem: ocp.Problem) -> None:
    nodes = Nodes(problem)
    reference: Any = nodes._path.placed[0].reference
    most: list[dict[str, int]] = []
    for begin in (0, 6000, 12_000):  # 120 s each
        sizes: dict[str, int] = {}
        for k in range(begin, begin + 6000, 20):
            nodes.running(k, 10)
            kept = {
                "rows": len(nodes._rows),
                "samples": len(nodes._samples),
                "phases": len(nodes._path._phases._found),
                "modes": len(nodes._compilation._modes),
                "targets": len(reference._kept),
                "stances": sum(map(len, reference.footsteps._known.stances)),
            }
            sizes = {name: max(size, sizes.get(name, 0)) for name, size in kept.items()}
        most.append(sizes)
    assert max(most[-1].values()) < 5100
    for name in most[0]:
        assert most[2][name] <= max(most[0][name], most[1][name]), name


def test_nodes_are_the_same_after_others_were_forgotten(problem: ocp.Problem) -> None:
    nodes, other = Nodes(problem), Nodes(problem)
    first = nodes.running(40, 12)
    for k in range(0, 4000, 10):
        nodes.running(k, 10)
    again = nodes.running(40, 12)
    for name in ("p", "weight", "g_mask", "h_mask"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
        np.testing.assert_array_equal(getattr(first, name), getattr(other.running(40, 12), name))


def test_phases_late_in_a_motion_are_those_of_walking_there() -> None:
    walk = models.gaits.trot(0.3).pieces
    times, durations = np.random.default_rng(0).uniform(20.0, 300.0, 300), sum(p.duration for p in walk[-1].cycle)
    edges = [walk[-1].once[0].duration + k * durations for k in range(200, 230)]
    listed = []
    for phase in placed_phases(walk):
        listed.append(phase)
        if phase.start > 310.0:
            break
    found = _PhasesByTime(walk)
    for t in [*times, *edges]:
        at = [phase for phase in listed if phase.start - ocp.SAME_TIME <= t][-1]
        before = [phase for phase in listed if phase.start < t - ocp.SAME_TIME][-1]
        for right, got in ((at, found.at(t)), (before, found.last_before(t))):
            assert (right.phase, right.piece, right.index) == (got.phase, got.piece, got.index)
            assert (right.start, right.end) == pytest.approx((got.start, got.end), abs=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_late_stances_are_those_of_walking_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    once = tuple((float(rng.uniform(0.05, 0.3)), rng.integers(0, 2, 2)) for _ in range(rng.integers(0, 3)))
    cycle = tuple((float(rng.uniform(0.05, 0.3)), rng.integers(0, 2, 2)) for _ in range(rng.integers(1, 5)))
    schedule = ContactSchedule(once, cycle)
    for foot in range(2):
        everything = schedule.stances(foot, 100.0)
        first, late = schedule.later_stances(foot, 60.0, 63.0)
        assert first == 0 or everything[first + 1, 0] <= 60.0
        assert late[-1, 0] > 63.0 or len(late) == len(schedule.stances(foot, 1e3))
        np.testing.assert_allclose(late, everything[first : first + len(late)], rtol=0, atol=1e-9)


def test_an_interrupt_among_the_footholds_leaves_those_of_before(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = models.load("solo12")
    body = models.Mujoco(robot)
    path: Any = Nodes(
        ocp.Problem(
            models.gaits.trot(0.3), body.over(0.2, dt=0.02), ocp.Objective(ocp.track(models.base.position)),
            initial=body.state(joints="stand"),
        )
    )._path  # fmt: skip
    footsteps = path.placed[0].reference.footsteps
    before, times = footsteps._known, np.array([LATE, LATE + 0.1])
    feet = iter(range(2))
    found = footsteps._foothold

    def interrupted(*stance: Any) -> Any:
        if next(feet, None) is None:
            raise KeyboardInterrupt
        return found(*stance)

    monkeypatch.setattr(footsteps, "_foothold", interrupted)
    with pytest.raises(KeyboardInterrupt):
        footsteps.at(times)
    assert footsteps._known is before
    monkeypatch.setattr(footsteps, "_foothold", found)
    other = path.placed[0].reference.footsteps.held(0.0, None, found)
    other._keep, other._held = [], np.inf
    np.testing.assert_array_equal(footsteps.at(times)[0], other.at(times)[0])
