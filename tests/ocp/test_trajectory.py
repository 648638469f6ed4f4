"""Trajectories: sampling on the manifold and at boundaries, moving them about, and what they can become."""

from math import pi

import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import ProblemError
from piaffe.ocp import Quantity, rotation
from piaffe.ocp.language.frame import ORIGIN, relative, transform

MODEL = ocp.Model(
    "top", state={"turn": "rotation", "z": 1}, control={"rate": 3}, modes={"go": lambda s: {"turn": s.rate, "z": 0}}
)
TURN, Z, RATE = (block.quantity for block in (*MODEL.state.blocks, *MODEL.control.blocks))
FORCE = Quantity("force", "N", "direction")


def part(name, times, yaws, mode="go"):
    """Return a phase that turns through some yaws, its height its time."""
    turns = rotation.np_from_rpy(np.array([[0.0, 0.0, yaw] for yaw in yaws]))
    states = np.hstack([turns, np.array(times)[:, None]])
    controls = np.arange(3.0 * (len(times) - 1)).reshape(-1, 3)
    outputs = {FORCE: 10.0 + controls}
    return ocp.PhaseTrajectory(
        name, mode, "top", np.array(times), states, controls, outputs, MODEL.state, MODEL.control
    )


TOLD = ocp.Trajectory((part("a", [1.0, 1.1, 1.2], [0.0, 1.0, 2.0]), part("b", [1.2, 1.4], [-1.0, -2.0])))


def test_states_are_interpolated_and_controls_held():
    sample = TOLD.sample(1.15)
    assert sample[TURN] == pytest.approx(rotation.np_from_rpy(np.array([0, 0, 1.5])))
    assert sample[Z] == pytest.approx([1.15])
    assert sample[RATE] == pytest.approx([3, 4, 5])
    assert sample[FORCE] == pytest.approx([13, 14, 15])


def test_a_boundary_belongs_to_the_later_phase():
    assert TOLD.phase_at(1.2).name == "b"
    assert TOLD.sample(1.2)[TURN] == pytest.approx(rotation.np_from_rpy(np.array([0, 0, -1.0])))
    assert TOLD.phases[0].sample(1.2)[TURN] == pytest.approx(rotation.np_from_rpy(np.array([0, 0, 2.0])))


def test_times_outside_are_those_of_the_ends():
    assert TOLD.sample(0.0)[Z] == pytest.approx([1.0])
    assert TOLD.sample(9.0)[Z] == pytest.approx([1.4])
    assert TOLD.duration == pytest.approx(0.4)
    assert [phase.duration for phase in TOLD.phases] == pytest.approx([0.2, 0.2])


def test_a_stretch_of_several_modes_is_no_phase_of_a_motion():
    told = ocp.Trajectory((part("plan", [0.0, 0.1], [0, 0]), part("tail", [0.1, 0.2], [0, 0], mode="scheduled")))
    with pytest.raises(
        ProblemError,
        match=r"motion \(test_trajectory\.py:\d+\): phase 'tail' of the trajectory spans several modes",
    ):
        ocp.Motion.from_trajectory(told)
    assert ocp.Motion.from_trajectory(told, modes={"tail": "go"}).duration == pytest.approx(0.2)
    assert ocp.Motion.from_trajectory(ocp.Trajectory(told.phases[:1])).duration == pytest.approx(0.1)


# ---- frames


def test_transform_moves_points_rotates_directions_and_keeps_vectors():
    point, direction, number = Quantity("p", "m", "point"), Quantity("d", "N", "direction"), Quantity("n", "Nm")
    moved = transform(
        {point: np.array([1.0, 0, 5, 0, 1, 6]), direction: np.array([1.0, 0, 7]), number: np.array([1.0, 2])},
        (10, 20, pi / 2),
    )
    assert moved[point] == pytest.approx([10, 21, 5, 9, 20, 6])
    assert moved[direction] == pytest.approx([0, 1, 7])
    assert moved[number] == pytest.approx([1, 2])


def test_transform_rotates_orientations_about_the_vertical():
    moved = transform({TURN: rotation.np_from_rpy(np.array([0.3, 0.2, 0.1]))}, (1, 2, 0.5))[TURN]
    assert rotation.np_to_rpy(moved) == pytest.approx([0.3, 0.2, 0.6])


def test_the_relative_motion_carries_one_frame_onto_the_other():
    of, to = (1.0, 2.0, 0.3), (-4.0, 0.5, 2.0)
    point = Quantity("p", "m", "point")
    motion = relative(to, of)
    assert motion[2] == pytest.approx(1.7)
    assert transform({point: np.array([*of[:2], 0.0])}, motion)[point] == pytest.approx([*to[:2], 0.0])
    assert relative(of, of) == pytest.approx(ORIGIN)
