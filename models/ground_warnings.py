"""Warnings about what a motion asks of the ground: standing feet at its start, long flights, far keyframes."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import Path, PlacedPhase, ProblemWarning, Sample, placed_phases

from .postures import place_feet
from .quantities import base, joints
from .robot import Robot
from .stance import Stance
from .terrain import Terrain

Array = NDArray[np.float64]

OFF_GROUND = 0.02
"""Largest distance of a standing foot from the ground without a warning [m]."""
_ROUNDING = 1e-6  # [m]; a foot at the limit gives no warning
ALL_OFF_GROUND = 0.01
"""The same if all standing feet are above it, or all are below it [m]: another robot has such a state."""
BEYOND_LIMIT = 0.01
"""How far a joint of the initial state may be beyond its limit without a warning [rad]."""
LONG_FLIGHT = 1.0
"""Longest time without contact that gives no warning [s]; a robot falls 1.2 m in the second half of it."""
FAST = 3.0
"""Largest speed between keyframes without a warning, in units of sqrt(g h), with the height h of the stand pose."""


def ground_warnings(
    robot: Robot, terrain: Terrain, resolve: Callable[[Hashable], Stance], path: Path
) -> Iterator[ProblemWarning]:
    """Yield warnings about a motion.

    Args:
        robot: the robot.
        terrain: the ground.
        resolve: function that returns the feet on the ground in a phase's mode.
        path: the motion's path.
    """
    count = sum(len(piece.phases) for piece in path.pieces)
    phases = list(islice(placed_phases(path.pieces), count))
    yield from _start(robot, terrain, resolve, path, phases[0])
    yield from _flights(resolve, phases)
    yield from _speeds(robot, path, phases)


def fastest(robot: Robot) -> float:
    """Return the speed of the base above which targets are reported [m/s]."""
    return FAST * float(np.sqrt(9.81 * robot.base_height("stand")))


def feet_off_ground(
    robot: Robot, terrain: Terrain, names: Iterable[str], position: Array, orientation: Array, angles: Array
) -> str:
    """Return what :func:`heights_off_ground` finds, in words; empty if nothing."""
    off = heights_off_ground(robot, terrain, names, position, orientation, angles)
    return ", ".join(f"{name} {abs(h):.3f} m {'above' if h > 0 else 'below'} it" for name, h in off.items())


def heights_off_ground(
    robot: Robot, terrain: Terrain, names: Iterable[str], position: Array, orientation: Array, angles: Array, *,
    least: float = OFF_GROUND,
) -> dict[str, float]:  # fmt: skip
    """Return the heights above the ground [m] of those feet that are farther than a distance from it.

    Args:
        robot: the robot.
        terrain: the ground.
        names: feet that should stand.
        position: of the base (3,) [m].
        orientation: of the base (4,).
        angles: of the joints (nj,) [rad].
        least: the distance [m].
    """
    places = place_feet(robot, position, orientation, angles)
    above = places[:, 2] - terrain.standing(places[:, :2], robot.foot_radius)[:, 2]
    heights = dict(zip(robot.foot_names, above, strict=True))
    return {name: float(heights[name]) for name in names if abs(heights[name]) > least + _ROUNDING}


def _start(
    robot: Robot, terrain: Terrain, resolve: Callable[[Hashable], Stance], path: Path, first: PlacedPhase
) -> Iterator[ProblemWarning]:
    """Yield the feet that stand in the first phase but are not on the ground in the initial state."""
    start: Sample = getattr(path.placed[0].reference, "start", {})
    if not all(quantity in start for quantity in (base.position, base.orientation, joints.position)):
        return
    pose = [np.asarray(start[quantity]) for quantity in (base.position, base.orientation, joints.position)]
    names = resolve(first.phase.mode).feet
    got = feet_off_ground(robot, terrain, names, *pose)
    where = f"phase '{first.phase.name}' ({first.phase.source}), initial state"
    beyond = np.flatnonzero(
        (pose[2] < robot.joint_lower - BEYOND_LIMIT) | (pose[2] > robot.joint_upper + BEYOND_LIMIT)
    )  # fmt: skip
    if len(beyond):
        joint = ", ".join(f"{robot.joint_names[i]} at {pose[2][i]:.3f} rad" for i in beyond)
        allowed = ", ".join(f"{robot.joint_lower[i]:.3f} to {robot.joint_upper[i]:.3f} rad" for i in beyond)
        yield ProblemWarning(
            where,
            f"joint of the initial state beyond its limit - got {joint}, expected {allowed}; build the initial state "
            f"of '{robot.name}' with the model's state(joints=...)",
            first.phase.source,
        )
    above = list(heights_off_ground(robot, terrain, names, *pose, least=ALL_OFF_GROUND).values())
    if not got and len(above) == len(names) and abs(sum(np.sign(above))) == len(names) > 1:
        side, gaps = "above" if above[0] > 0 else "below", [abs(height) for height in above]
        yield ProblemWarning(
            where,
            f"all standing feet are off the ground - got {min(gaps):.3f} to {max(gaps):.3f} m {side} it, expected at "
            f"most {ALL_OFF_GROUND} m; is it the state of another robot? Build that of "
            f"'{robot.name}' with the model's state(joints=...)",
            first.phase.source,
        )
    if got:
        yield ProblemWarning(
            where,
            f"standing foot is not on the ground - got {got}, expected within {OFF_GROUND} m; build the initial state "
            f"of '{robot.name}' with the model's state(joints=...), or begin with a flight",
            first.phase.source,
        )


def _flights(resolve: Callable[[Hashable], Stance], phases: list[PlacedPhase]) -> Iterator[ProblemWarning]:
    """Yield the first phase of each flight that is longer than ``LONG_FLIGHT``."""
    began: PlacedPhase | None = None
    for placed, following in zip(phases, [*phases[1:], None], strict=True):
        if resolve(placed.phase.mode).feet:
            began = None
            continue
        began = began or placed
        ends = following is None or bool(resolve(following.phase.mode).feet)
        length = placed.end - began.start
        if ends and length > LONG_FLIGHT:
            rise = 9.81 * length**2 / 8
            yield ProblemWarning(
                f"phase '{began.phase.name}' ({began.phase.source})",
                f"the flight is long - got {length:g} s without contact, in which a body must rise by {rise:.2f} m, "
                f"expected at most {LONG_FLIGHT:g} s; give seconds, or put feet on the ground",
                began.phase.source,
            )


def _speeds(robot: Robot, path: Path, phases: list[PlacedPhase]) -> Iterator[ProblemWarning]:
    """Yield keyframes that the base reaches only at more than ``FAST`` times sqrt(g h)."""
    height, limit = robot.base_height("stand"), fastest(robot)
    for placed in phases:
        target = placed.phase.target
        if target is None or not {"position", base.position.path} & set(target.values):
            continue
        before = path.interval_before(placed.start) if placed.start > 0 else placed
        start, end = path.sample(placed.start, before), path.sample(placed.end, placed)
        if base.position not in start or base.position not in end:
            continue
        way = float(np.linalg.norm(np.asarray(end[base.position]) - np.asarray(start[base.position])))
        speed = way / placed.phase.duration
        if speed > limit:
            yield ProblemWarning(
                f"phase '{placed.phase.name}' ({placed.phase.source}), keyframe",
                f"the base is far from the keyframe before - got {way:.3g} m in {placed.phase.duration:g} s, "
                f"{speed:.3g} m/s, expected at most {limit:.3g} m/s, {FAST:g} sqrt(g h) of '{robot.name}' at "
                f"h = {height:.3g} m; give metres and seconds, or add phases",
                placed.phase.source,
            )
