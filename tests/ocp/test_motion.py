"""Phases and motions as values: composition, cycles, keyframes, and what cannot be one."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import ProblemError

HERE = Path(__file__).name
STEP = ocp.Motion(ocp.Phase("left", "go", 0.2), ocp.Phase("right", "go", 0.3))
GAIT = ocp.Motion(ocp.Phase("left", "go", 0.2), ocp.Phase("right", "go", 0.3), cyclic=True)


def names(motion, count=20):
    return [interval.phase.name for interval in islice(motion.intervals(), count)]


def test_phases_follow_each_other_in_time():
    intervals = list((STEP + STEP).intervals())
    assert [(i.phase.name, i.piece, i.index) for i in intervals] == [
        ("left", 0, 0), ("right", 0, 1), ("left", 1, 0), ("right", 1, 1),
    ]  # fmt: skip
    assert [i.start for i in intervals] == pytest.approx([0, 0.2, 0.5, 0.7])
    assert (STEP + STEP).duration == pytest.approx(1.0)


def test_a_cyclic_motion_never_ends():
    assert GAIT.duration == float("inf")
    assert names(GAIT, 5) == ["left", "right", "left", "right", "left"]


def test_cycles_choose_how_often():
    assert names(GAIT.cycles(2)) == ["left", "right"] * 2
    assert GAIT.cycles(2).duration == pytest.approx(1.0)
    assert names(STEP.cycles(2)) == ["left", "right"] * 2


def test_motions_are_values():
    """Adding and cycling leave what they were made of alone."""
    before = names(STEP)
    _ = STEP + STEP, STEP.cycles(3), GAIT.cycles(1)
    assert names(STEP) == before
    assert GAIT.duration == float("inf")


def test_what_runs_once_comes_first_and_is_not_repeated():
    gait = ocp.Motion(ocp.Phase("a", "go", 0.1), cyclic=True, once=(ocp.Phase("stand", "go", 0.5),))
    assert names(gait.cycles(2)) == ["stand", "a", "a"]
    assert names(gait, 4) == ["stand", "a", "a", "a"]


def test_the_last_piece_may_be_endless():
    assert names(STEP + GAIT, 6) == ["left", "right"] * 3


def test_nothing_follows_an_endless_motion():
    with pytest.raises(
        ProblemError,
        match=rf"motion \({HERE}:\d+\): an endless motion cannot be followed by another - got a cyclic motion, "
        r"expected a finite one; choose a number with \.cycles\(n\)",
    ):
        GAIT + STEP


@pytest.mark.parametrize("n", [0, -1, 1.5])
def test_cycles_are_at_least_one(n):
    with pytest.raises(ProblemError, match=rf"cycles is out of range - got {n}, expected a whole number, at least 1"):
        GAIT.cycles(n)


def test_a_motion_needs_phases():
    with pytest.raises(ProblemError, match="no phases - got none, expected at least one ocp.Phase"):
        ocp.Motion()
    with pytest.raises(ProblemError, match="not a phase - got 'push', expected an ocp.Phase"):
        ocp.Motion("push")


def test_a_free_duration_is_understood_and_refused():
    with pytest.raises(
        ProblemError,
        match=rf"phase 'flight' \({HERE}:\d+\): free durations are not optimised yet - got "
        rf"Free\(guess=0\.42, lower=0\.3, "
        r"upper=0\.6\), expected a number of seconds; use 0\.42",
    ):
        ocp.Phase("flight", "go", ocp.Free(0.42, 0.30, 0.60))


def test_a_free_duration_has_its_bounds_in_order():
    with pytest.raises(ProblemError, match=r"bounds are out of order - got guess 0\.2 s, expected 0 < lower ≤ guess"):
        ocp.Free(0.2, 0.3, 0.6)


@pytest.mark.parametrize("duration", [0.0, -0.1, 1e-12, 9e-8, float("inf"), "long", None, True, np.True_])
def test_durations_are_positive_numbers(duration):
    with pytest.raises(
        ProblemError,
        match=r"phase 'a' \(.*\): duration is out of range - got .*, expected a number of seconds above 1e-07",
    ):
        ocp.Phase("a", "go", duration)


def test_a_numpy_duration_is_a_number():
    assert ocp.Phase("a", "go", np.float64(0.2)).duration == 0.2


def test_a_target_is_a_keyframe_or_a_mapping():
    assert ocp.Phase("a", "go", 0.1, {"z": 1.0}).target == ocp.Keyframe(z=1.0)
    with pytest.raises(ProblemError, match=r"target is unusable - got \(0, 1\), expected a Keyframe or a mapping"):
        ocp.Phase("a", "go", 0.1, (0, 1))


def test_a_reset_is_made_by_reset():
    with pytest.raises(ProblemError, match=r"reset is unusable - got .*, expected ocp\.reset\(function\); wrap it"):
        ocp.Phase("a", "go", 0.1, reset=lambda s: {})


def test_until_holds_at_the_end_of_the_phase():
    touch = ocp.equality(lambda s: s.z)
    (row,) = ocp.Phase("a", "go", 0.1, until=touch).until
    assert (row.at, touch.at) == ("phase_end", "running")
    assert row.source == touch.source


def test_keyframes_beside_another_reference_are_refused():
    phase = ocp.Phase("a", "go", 0.1, {"z": 1})
    reference = ocp.FromArrays([0, 1], {"z": [0, 1]})
    with pytest.raises(
        ProblemError, match=r"phase 'a' \(.*\): its keyframe applies nowhere - got a motion whose targets come from F"
    ):
        ocp.Motion(phase, reference=reference)
    with pytest.raises(ProblemError, match=r"reference is unusable - got 3, expected one like ocp\.FromArrays"):
        ocp.Motion(ocp.Phase("a", "go", 0.1), reference=3)
    (piece,) = ocp.Motion(ocp.Phase("a", "go", 0.1), reference=reference).pieces
    assert [quantity.path for quantity in reference.columns] == ["z"]
    assert piece.reference is reference


def test_until_is_an_equality():
    inequality = ocp.inequality(lambda s: s.z, name="above")
    with pytest.raises(ProblemError, match=r"until is no switching constraint - got the inequality 'above', expected"):
        ocp.Phase("a", "go", 0.1, until=inequality)
    with pytest.raises(ProblemError, match=r"until is no switching constraint - got function, expected an ocp.equal"):
        ocp.Phase("a", "go", 0.1, until=lambda s: s.z)


def test_a_phase_takes_single_terms_of_its_own():
    cost, row = ocp.track("z"), ocp.inequality(lambda s: s.z)
    phase = ocp.Phase("a", "go", 0.1, objective=cost, constraints=row)
    assert (phase.objective.terms, phase.constraints.terms) == ((cost,), (row,))
    with pytest.raises(ProblemError, match=r"not a term - got the inequality 'inequality'"):
        ocp.Phase("a", "go", 0.1, objective=row)


def test_a_phase_has_a_name():
    with pytest.raises(ProblemError, match=r"name is unusable - got 3, expected some text"):
        ocp.Phase(3, "go", 0.1)


def test_from_trajectory_keeps_phases_modes_and_durations():
    ball = ocp.Model("ball", state={"z": 1}, modes={"fall": lambda s: {"z": -1}, "rise": lambda s: {"z": 1}})
    parts = tuple(
        ocp.PhaseTrajectory(name, mode, "ball", times, np.zeros((3, 1)), np.zeros((2, 0)), {}, ball.state, ball.control)
        for name, mode, times in (("down", "fall", np.array([0, 0.1, 0.2])), ("up", "rise", np.array([0.2, 0.4, 0.6])))
    )
    motion = ocp.Motion.from_trajectory(ocp.Trajectory(parts))
    assert [(i.phase.name, i.phase.mode) for i in motion.intervals()] == [("down", "fall"), ("up", "rise")]
    assert [i.phase.duration for i in motion.intervals()] == pytest.approx([0.2, 0.4])
    renamed = ocp.Motion.from_trajectory(ocp.Trajectory(parts), modes={"up": 7})
    assert [i.phase.mode for i in renamed.intervals()] == ["fall", 7]
