"""Warnings about velocities that no robot has, of initial states and keyframes: degrees are the usual cause."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from piaffe.ocp import Keyframes, Path, PlacedPhase, ProblemWarning, Quantity, Sample, placed_phases

from .ground_warnings import fastest
from .quantities import base, joints
from .robot import Robot

TURNING = 5.0
"""Largest angular velocity of a base without a warning, in units of sqrt(g / h), with the height h of the stand."""
JOINTS = 2.0
"""Largest speed of a joint without a warning, in units of its limit."""


def speed_warnings(robot: Robot, path: Path) -> Iterator[ProblemWarning]:
    """Yield velocities of the initial state and of keyframes that are too large for the robot.

    Args:
        robot: the robot.
        path: the motion's path.
    """
    count = sum(len(piece.phases) for piece in path.pieces)
    phases = list(islice(placed_phases(path.pieces), count))
    start: Sample = getattr(path.placed[0].reference, "start", {})
    yield from _too_fast(robot, start, phases[0], "initial state")
    for placed in phases:
        target = placed.phase.target
        if target is not None and isinstance(path.pieces[placed.piece].reference, Keyframes):
            end = path.sample(placed.end, placed)
            named = {quantity: end[quantity] for quantity in _given(target.values) if quantity in end}
            yield from _too_fast(robot, named, placed, "keyframe")


def _given(values: object) -> list[Quantity]:
    names = {
        "linear_velocity": base.linear_velocity,
        "angular_velocity": base.angular_velocity,
        "joint_velocities": joints.velocity,
    }
    names |= {quantity.path: quantity for quantity in names.values()}
    return [quantity for name, quantity in names.items() if name in values]  # type: ignore[operator]  # a mapping


def _too_fast(robot: Robot, sample: Sample, placed: PlacedPhase, what: str) -> Iterator[ProblemWarning]:
    where = f"phase '{placed.phase.name}' ({placed.phase.source}), {what}"
    found = []
    if robot.base == "free" and robot.feet:
        height = robot.base_height("stand")
        turning = TURNING * float(np.sqrt(9.81 / height)) if height > 0 else np.inf
        for quantity, limit, unit in (
            (base.linear_velocity, fastest(robot) if height > 0 else np.inf, "m/s"),
            (base.angular_velocity, turning, "rad/s"),
        ):
            speed = float(np.linalg.norm(np.asarray(sample.get(quantity, 0.0))))
            if speed > limit:
                found.append((quantity.path, f"{speed:.3g} {unit}", f"at most {limit:.3g} {unit}"))
    speeds = np.abs(np.asarray(sample.get(joints.velocity, np.zeros(robot.num_joints))))
    over = np.flatnonzero(speeds > JOINTS * robot.joint_speed_limit)
    if over.size:
        i = int(over[0])
        expected = f"at most {robot.joint_speed_limit[i]:.3g}, the limit of the joint"
        found.append((f"{joints.velocity.path} {robot.joint_names[i]}", f"{speeds[i]:.3g}", expected))
    for name, got, expected in found:
        yield ProblemWarning(
            where,
            f"'{name}' is very fast - got {got}, expected {expected}; give metres, radians and seconds",
            placed.phase.source,
        )
