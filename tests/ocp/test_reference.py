"""References: keyframes as knots of a path, arrays and trajectories; velocities, sides of a jump, full turns."""

from math import pi

import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import ProblemError, ShapeError
from piaffe.ocp import Block, Manifold, Quantity, rotation
from piaffe.ocp.language.model import Dynamics, ModelBase, Quantities

POSITION, ATTITUDE = Quantity("position", "m", "point"), Quantity("attitude", "rad", "rotation")
SPEED, SPIN = Quantity("speed", "m/s", "direction"), Quantity("spin", "rad/s")
XYZ = ("x", "y", "z")


class Body(ModelBase):
    """A free body; enough of a model to place motions in the world."""

    def __init__(self):
        blocks = (
            Block(POSITION, XYZ), Block(ATTITUDE, XYZ),
            Block(SPEED, XYZ, rate_of=POSITION), Block(SPIN, XYZ, rate_of=ATTITUDE),
        )  # fmt: skip
        super().__init__("body", Manifold(blocks), Manifold(()))

    def mode_key(self, mode):
        return str(mode)

    def dynamics(self, key, x, u, z, p):
        return Dynamics(z, x, Quantities("body", {}))

    def planar_frame(self, sample):
        return (*sample[POSITION][:2], rotation.np_to_rpy(sample[ATTITUDE])[2])


BODY = Body()


def start(position=(0, 0, 0), rpy=(0, 0, 0), speed=(0, 0, 0)):
    return {
        POSITION: np.array(position, dtype=float),
        ATTITUDE: rotation.np_from_rpy(np.array(rpy, dtype=float)),
        SPEED: np.array(speed, dtype=float),
        SPIN: np.zeros(3),
    }


def phase(name, duration, **target):
    return ocp.Phase(name, "free", duration, target or None)


def bound(motion, first=None):
    return motion.bind((BODY,), first or start())


def at(path, t, before=False):
    return path.sample(t, path.interval_before(t) if before else path.interval_at(t))


def turns(path, until, quantity=ATTITUDE):
    """Return the rotation vector summed over small steps of the path, (3,) [rad]: a full turn counts."""
    q = np.array([at(path, t)[quantity] for t in np.linspace(0.0, until, 400, endpoint=False)])
    q = np.vstack([q, at(path, until, before=True)[quantity]])
    return rotation.np_log(rotation.np_multiply(rotation.np_conjugate(q[:-1]), q[1:])).sum(axis=0)


# ---- keyframes


def test_knots_are_joined_by_straight_lines_from_the_start():
    path = bound(ocp.Motion(phase("a", 0.2, position=(1, 0, 0)), phase("b", 0.4, position=(1, 2, 0))), start((0, 0, 1)))
    assert at(path, 0.0)[POSITION] == pytest.approx([0, 0, 1])
    assert at(path, 0.1)[POSITION] == pytest.approx([0.5, 0, 0.5])
    assert at(path, 0.3)[POSITION] == pytest.approx([1, 0.5, 0])
    assert at(path, 0.6, before=True)[POSITION] == pytest.approx([1, 2, 0])


def test_velocities_are_the_derivative_on_the_side_of_the_phase_that_asks():
    path = bound(ocp.Motion(phase("a", 0.2, position=(1, 0, 0)), phase("b", 0.4, position=(1, 2, 0))))
    assert at(path, 0.1)[SPEED] == pytest.approx([5, 0, 0])
    assert at(path, 0.2, before=True)[SPEED] == pytest.approx([5, 0, 0])
    assert at(path, 0.2)[SPEED] == pytest.approx([0, 5, 0])
    assert at(path, 0.6, before=True)[SPEED] == pytest.approx([0, 5, 0])


def test_a_velocity_that_a_keyframe_gives_is_interpolated():
    path = bound(ocp.Motion(phase("a", 0.2, position=(1, 0, 0), speed=(4, 0, 0))), start(speed=(2, 0, 0)))
    assert at(path, 0.1)[SPEED] == pytest.approx([3, 0, 0])


def test_what_a_keyframe_leaves_out_goes_on_to_the_next_that_names_it():
    path = bound(
        ocp.Motion(phase("a", 0.2, attitude=(0.2, 0, 0)), phase("b", 0.2, position=(1, 0, 0), attitude=(0.2, 0, 0)))
    )
    assert at(path, 0.2)[POSITION] == pytest.approx([0.5, 0, 0])


def test_what_no_keyframe_names_stays_where_it_started():
    path = bound(ocp.Motion(phase("a", 0.2, position=(1, 0, 0))), start(rpy=(0.1, 0.2, 0.3)))
    assert at(path, 0.2)[ATTITUDE] == pytest.approx(rotation.np_from_rpy(np.array([0.1, 0.2, 0.3])))
    assert at(path, 0.1)[SPIN] == pytest.approx([0, 0, 0])


def test_after_the_last_keyframe_the_path_rests():
    path = bound(ocp.Motion(phase("a", 0.2, position=(1, 0, 0)), phase("b", 0.2)))
    assert at(path, 0.3)[POSITION] == pytest.approx([1, 0, 0])
    assert at(path, 0.3)[SPEED] == pytest.approx([0, 0, 0])


@pytest.mark.parametrize("angles", [(2 * pi, 0, 0), (-2 * pi, 0, 0), (0, 2 * pi, 0), (0, 0, 4 * pi)])
def test_a_full_turn_keeps_its_winding(angles):
    path = bound(ocp.Motion(phase("turn", 0.5, attitude=angles)))
    assert turns(path, 0.5) == pytest.approx(angles, abs=1e-9)
    axis = int(np.argmax(np.abs(angles)))
    assert at(path, 0.2)[SPIN][axis] == pytest.approx(angles[axis] / 0.5)


def test_the_spin_is_the_body_rate_of_the_interpolated_angles():
    path, step = bound(ocp.Motion(phase("a", 0.4, attitude=(0.8, 0.5, -1.0)))), 1e-6
    before, after = at(path, 0.2 - step)[ATTITUDE], at(path, 0.2 + step)[ATTITUDE]
    moved = rotation.np_log(rotation.np_multiply(rotation.np_conjugate(before), after)) / (2 * step)
    assert at(path, 0.2)[SPIN] == pytest.approx(moved, abs=1e-7)


def test_a_start_beyond_a_quarter_turn_of_pitch_goes_the_short_way():
    """Roll, pitch and yaw of a body pitched by 2.0 rad are (π, 1.14, π) to most; the keyframe's own angles decide."""
    path = bound(ocp.Motion(phase("on", 0.5, attitude=(0, 2.5, 0))), start(rpy=(0, 2.0, 0)))
    assert turns(path, 0.5) == pytest.approx([0, 0.5, 0], abs=1e-9)


# ---- pieces one after the other


def test_a_piece_is_carried_to_where_the_one_before_it_ended():
    step = ocp.Motion(phase("step", 0.5, position=(1, 0, 0.3), attitude=(0, 0, pi / 2)))
    path = bound(step + step + step)
    assert at(path, 1.0, before=True)[POSITION] == pytest.approx([1, 1, 0.3])
    assert at(path, 1.5, before=True)[POSITION] == pytest.approx([0, 1, 0.3])
    assert turns(path, 1.5) == pytest.approx([0, 0, 1.5 * pi], abs=1e-9)


def test_height_is_not_carried():
    low = ocp.Motion(phase("low", 0.5, position=(1, 0, 0.1)))
    high = ocp.Motion(phase("high", 0.5, position=(0, 0, 0.4)))
    assert at(bound(low + high), 1.0, before=True)[POSITION] == pytest.approx([1, 0, 0.4])


def test_a_full_turn_of_yaw_survives_a_piece_before_it():
    turned = ocp.Motion(phase("turn a little", 0.5, attitude=(0, 0, 0.3)))
    whole = ocp.Motion(phase("turn", 0.5, attitude=(0, 0, 2 * pi)))
    assert turns(bound(turned + whole), 1.0) == pytest.approx([0, 0, 0.3 + 2 * pi], abs=1e-9)


def test_two_rolls_are_two_turns():
    roll = ocp.Motion(phase("roll", 0.5, attitude=(2 * pi, 0, 0)))
    assert turns(bound(roll + roll), 1.0) == pytest.approx([4 * pi, 0, 0], abs=1e-9)
    assert turns(bound(roll.cycles(3)), 1.5) == pytest.approx([6 * pi, 0, 0], abs=1e-9)


def test_a_cycle_begins_where_the_last_one_ended():
    walk = ocp.Motion(phase("left", 0.2, position=(0.1, 0, 0)), phase("right", 0.2, position=(0.2, 0, 0)), cyclic=True)
    for motion in (walk, walk.cycles(4)):
        path = bound(motion)
        assert at(path, 0.4, before=True)[POSITION] == pytest.approx([0.2, 0, 0])
        assert at(path, 0.6, before=True)[POSITION] == pytest.approx([0.3, 0, 0])
        assert at(path, 1.6, before=True)[POSITION] == pytest.approx([0.8, 0, 0])
        assert at(path, 1.5)[SPEED] == pytest.approx([0.5, 0, 0])


def test_phases_that_run_once_come_before_the_cycles():
    walk = ocp.Motion(
        phase("step", 0.2, position=(0.1, 0, 0)), cyclic=True, once=(phase("rise", 0.5, position=(0, 0, 1)),)
    )
    path = bound(walk)
    assert at(path, 0.5, before=True)[POSITION] == pytest.approx([0, 0, 1])
    assert at(path, 0.7, before=True)[POSITION] == pytest.approx([0.1, 0, 0])
    assert at(path, 0.9, before=True)[POSITION] == pytest.approx([0.2, 0, 0])


# ---- arrays and trajectories


def test_arrays_are_interpolated_and_carried():
    table = ocp.FromArrays([0.0, 1.0], {POSITION: [[0, 0, 0], [2, 0, 0]]})
    follow = ocp.Motion(phase("follow", 1.0), reference=table)
    path = bound(ocp.Motion(phase("turn", 0.5, attitude=(0, 0, pi / 2))) + follow)
    assert at(path, 1.0)[POSITION] == pytest.approx([0, 1, 0])
    assert at(path, 1.0)[ATTITUDE] == pytest.approx(rotation.np_from_rpy(np.array([0, 0, pi / 2])))


def test_arrays_interpolate_quaternions_to_unit_length():
    ends = rotation.np_from_rpy(np.array([[0, 0, 0], [0, 0, 2.0]]))
    path = bound(ocp.Motion(phase("a", 1.0), reference=ocp.FromArrays([0, 1], {ATTITUDE: ends})))
    assert np.linalg.norm(at(path, 0.3)[ATTITUDE]) == pytest.approx(1.0)


@pytest.mark.parametrize("times", [[0.0, 0.0], [1.0, 0.5], [[0.0, 1.0]]])
def test_times_that_do_not_increase(times):
    with pytest.raises(ProblemError, match=r"FromArrays \(test_reference\.py:\d+\): times are unusable"):
        ocp.FromArrays(times, {POSITION: np.zeros((2, 3))})


def test_arrays_with_missing_rows_or_numbers():
    with pytest.raises(
        ShapeError,
        match=r"FromArrays \(test_reference\.py:\d+\), 'position': wrong number of rows - got \(3,\), expected 2",
    ):
        ocp.FromArrays([0, 1], {POSITION: np.zeros((3, 3))})
    with pytest.raises(
        ProblemError,
        match=r"FromArrays \(test_reference\.py:\d+\), 'position': values are unusable - got NaN or infinity",
    ):
        ocp.FromArrays([0, 1], {POSITION: np.full((2, 3), np.nan)})


def recorded(*stretches):
    """Return a trajectory through states given as (position, rpy) pairs, 0.1 s apart; one phase per argument."""
    parts, t = [], 0.0
    for number, knots in enumerate(stretches):
        states = np.array([BODY.state.pack(start(*knot)) for knot in knots])
        times = t + 0.1 * np.arange(len(knots))
        t = times[-1]
        parts.append(
            ocp.PhaseTrajectory(
                f"p{number}", "free", "body", times, states, np.zeros((len(knots) - 1, 0)), {}, BODY.state, BODY.control
            )
        )
    return ocp.Trajectory(tuple(parts))


def test_a_trajectory_is_interpolated_on_the_manifold():
    told = recorded([((0, 0, 0), (0, 0, 0)), ((1, 0, 0), (0, 0, 1.0))])
    path = bound(ocp.Motion.from_trajectory(told))
    assert at(path, 0.05)[POSITION] == pytest.approx([0.5, 0, 0])
    assert at(path, 0.05)[ATTITUDE] == pytest.approx(rotation.np_from_rpy(np.array([0, 0, 0.5])))


def test_a_trajectory_is_carried_from_its_own_start_to_the_piece_s():
    """Recorded somewhere else, facing elsewhere; a roll in it goes on."""
    told = recorded(
        [((5, 5, 0.3), (0, 0, pi / 2)), ((5, 6, 0.3), (1.0, 0, pi / 2))],
        [((5, 6, 0.3), (1.0, 0, pi / 2)), ((5, 7, 0.4), (2.0, 0, pi / 2))],
    )
    there = ocp.Motion(phase("go", 0.5, position=(1, 0, 0.3), attitude=(0, 0, pi)))
    path = bound(there + ocp.Motion.from_trajectory(told))
    assert at(path, 0.6, before=True)[POSITION] == pytest.approx([0, 0, 0.3])
    assert at(path, 0.7, before=True)[POSITION] == pytest.approx([-1, 0, 0.4])
    assert rotation.np_log(
        rotation.np_multiply(
            rotation.np_conjugate(at(path, 0.7, before=True)[ATTITUDE]), rotation.np_from_rpy(np.array([2.0, 0, pi]))
        )
    ) == pytest.approx([0, 0, 0], abs=1e-9)


def test_a_trajectory_knows_both_sides_of_a_reset():
    told = recorded([((0, 0, 1), (0, 0, 0)), ((0, 0, 0), (0, 0, 0))], [((0, 0, 2), (0, 0, 0)), ((0, 0, 3), (0, 0, 0))])
    path = bound(ocp.Motion.from_trajectory(told))
    assert at(path, 0.1, before=True)[POSITION] == pytest.approx([0, 0, 0])
    assert at(path, 0.1)[POSITION] == pytest.approx([0, 0, 2])
