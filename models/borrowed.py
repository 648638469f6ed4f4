"""Warnings about targets from a trajectory of another robot."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import FromTrajectory, Path, Phase, PhaseTrajectory, ProblemWarning

from .ground_warnings import OFF_GROUND, feet_off_ground
from .postures import RobotState
from .quantities import base, joints
from .robot import Robot
from .stance import Stance
from .terrain import Terrain

Array = NDArray[np.float64]


def trajectory_warnings(
    robot: Robot, terrain: Terrain, resolve: Callable[[Hashable], Stance], path: Path
) -> Iterator[ProblemWarning]:
    """Yield a warning for each trajectory of targets that is of another robot, or that this one does not stand in.

    A trajectory in memory knows its robot. One from a file does not; then the feet that stand must be on the ground
    when this robot has its joint angles.

    Args:
        robot: the robot.
        terrain: the ground.
        resolve: function that returns the feet on the ground in a phase's mode.
        path: the motion's path.
    """
    for piece in path.pieces:
        if not isinstance(piece.reference, FromTrajectory):
            continue
        parts = piece.reference.trajectory.phases
        owners = [part.state.robot for part in parts if isinstance(part.state, RobotState)]
        found = next((owner for owner in owners if not _same_mechanism(owner, robot)), None)
        if found is not None:
            yield ProblemWarning(
                f"motion, phase '{piece.phases[0].name}' ({piece.phases[0].source})",
                f"the targets are of another robot - got a trajectory of '{found.name}', expected one of "
                f"'{robot.name}'; use a solution of this robot",
                piece.phases[0].source,
            )
        else:
            yield from _off_ground(robot, terrain, resolve, list(zip(piece.phases, parts, strict=False)))


def _same_mechanism(a: Robot, b: Robot) -> bool:
    """Return whether two robots have the same joints in the same places; masses and limits may differ."""
    if a.joint_names != b.joint_names:
        return False
    pairs = zip(a.model.jointPlacements, b.model.jointPlacements, strict=True)
    return all(one.isApprox(other, 1e-6) for one, other in pairs)


def _off_ground(
    robot: Robot, ground: Terrain, resolve: Callable[[Hashable], Stance], parts: list[tuple[Phase, PhaseTrajectory]]
) -> Iterator[ProblemWarning]:
    """Yield the first phase in which a standing foot is not on the ground, with the joint angles of a trajectory."""
    for phase, part in parts:
        where, names = part.state.slices, resolve(phase.mode).feet
        if joints.position not in where or base.position not in where or not names:
            continue
        x = part.states[len(part.states) // 2]
        if x[where[joints.position]].shape != (robot.num_joints,):
            continue
        pose = (x[where[key]] for key in (base.position, base.orientation, joints.position))
        got = feet_off_ground(robot, ground, names, *pose)
        if got:
            yield ProblemWarning(
                f"motion, phase '{phase.name}' ({phase.source})",
                f"standing foot is not on the ground in the trajectory of the targets - got {got}, expected within "
                f"{OFF_GROUND} m; use a solution of '{robot.name}', the trajectory is of model '{part.model}'",
                phase.source,
            )
            return
