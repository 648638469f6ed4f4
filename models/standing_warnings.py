"""Warnings about keyframes whose base is out of the reach of feet that stay where they stand."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import Path, PlacedPhase, ProblemWarning, Sample, placed_phases

from .kinematics import Kinematics
from .postures import place_feet
from .quantities import base, joints
from .robot import Robot
from .stance import Stance

Array = NDArray[np.float64]

OUT_OF_REACH = 0.1
"""Distance of a standing foot from the nearest place in reach, as a part of the leg's reach, above which
a keyframe is reported."""

_POSE = (base.position, base.orientation, joints.position)
_NAMES = {"position", "rpy", base.position.path, base.orientation.path}


def standing_warnings(robot: Robot, resolve: Callable[[Hashable], Stance], path: Path) -> Iterator[ProblemWarning]:
    """Yield keyframes of a floating robot whose base moves away from feet that stay.

    A foot stays from the phase in which it lands to the end of the last phase without a break. Its place is that of the
    initial state, or of the keyframe at which it lands.

    Args:
        robot: the robot.
        resolve: function that returns the feet on the ground in a phase's mode.
        path: the motion's path.
    """
    count = sum(len(piece.phases) for piece in path.pieces)
    legs, standing = Kinematics(robot), dict[str, Array]()
    before: PlacedPhase | None = None
    for placed in islice(placed_phases(path.pieces), count):
        names = resolve(placed.phase.mode).feet
        start = getattr(path.placed[0].reference, "start", {}) if before is None else path.sample(placed.start, before)
        places = _places(robot, start)
        known = places | standing
        standing = {name: known[name] for name in names if name in known}
        target = placed.phase.target
        end = path.sample(placed.end, placed)
        if standing and target is not None and _NAMES & set(target.values) and _has_pose(end):
            got = _missed(robot, legs, standing, end)
            if got:
                yield ProblemWarning(
                    f"phase '{placed.phase.name}' ({placed.phase.source}), keyframe",
                    f"the base moves away from feet that stand - got {got} out of reach of its leg, expected at most "
                    f"{OUT_OF_REACH:g} of the leg's reach; move the base less, or lift the feet in a phase before",
                    placed.phase.source,
                )
        before = placed


def _has_pose(sample: Sample) -> bool:
    return all(quantity in sample for quantity in _POSE)


def _places(robot: Robot, sample: Sample) -> dict[str, Array]:
    """Return where the feet are in a sample, (3,) each [m]; empty if it has no posture."""
    if not _has_pose(sample):
        return {}
    places = place_feet(robot, *(np.asarray(sample[quantity]) for quantity in _POSE))
    return dict(zip(robot.foot_names, places, strict=True))


def _missed(robot: Robot, legs: Kinematics, standing: dict[str, Array], sample: Sample) -> str:
    """Return the standing feet that the legs do not reach at a pose of the base, in words; empty if there are none."""
    position, orientation, angles = (np.asarray(sample[quantity], dtype=float) for quantity in _POSE)
    wanted = place_feet(robot, position, orientation, angles)
    for name, place in standing.items():
        wanted[robot.foot_names.index(name), :2] = place[:2]  # another height is reported by itself
    starts = np.array([angles, robot.pose("stand"), robot.pose("crouch")])
    places, turns = (np.tile(each, (len(starts), 1)) for each in (position, orientation))
    missed = legs.world_inverse(places, turns, np.tile(wanted, (len(starts), 1, 1)), starts)[1].min(axis=0)
    far = {
        name: missed[i]
        for i, name in enumerate(robot.foot_names)
        if name in standing and missed[i] > OUT_OF_REACH * legs.reach[i] > 0
    }
    return ", ".join(f"{name} {distance:.3f} m" for name, distance in far.items())
