"""The hull of a robot in a MuJoCo scene: base and legs that touch the ground, so that a fallen one does not sink."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .mujoco_look import import_mujoco, scale
from .robot import ROOT, Robot

Array = NDArray[np.float64]

HULL_GROUP = 4  # a viewer shows groups 0 to 2 unless told otherwise
_THIN = 0.7  # a shank's radius over the foot's, so that the foot touches level ground first


def add_hull(robot: Robot, bodies: Mapping[int, Any], surface: Mapping[str, Any]) -> None:
    """Add a box between the first joints of the legs, and a capsule from each joint to the next or the foot.

    Args:
        robot: the robot.
        bodies: the bodies of a ``mujoco.MjSpec`` by the index of their joint in the pinocchio model.
        surface: options of the geoms.
    """
    types, look = import_mujoco().mjtGeom, {"group": HULL_GROUP, "contype": 0, "conaffinity": 1, **surface}
    thick = max(_THIN * robot.foot_radius, 0.01 * scale(robot))
    hips = np.array([end for joint, end in _segments(robot) if joint == ROOT])
    if len(hips):
        middle, half = (hips.max(axis=0) + hips.min(axis=0)) / 2, np.ptp(hips, axis=0) / 2
        bodies[ROOT].add_geom(
            name="base hull", type=types.mjGEOM_BOX, pos=middle, size=np.maximum(half, 2 * thick), **look
        )
    for joint, end in _segments(robot):
        if joint != ROOT and np.linalg.norm(end) > 2 * thick:
            bodies[joint].add_geom(type=types.mjGEOM_CAPSULE, fromto=(0, 0, 0, *end), size=(thick, 0, 0), **look)


def _segments(robot: Robot) -> Iterator[tuple[int, Array]]:
    """Return what lies on each joint's link: the joints that hang on it and the feet, in the link's axes."""
    model = robot.model
    for joint in range(ROOT + 1, model.njoints):
        yield int(model.parents[joint]), np.array(model.jointPlacements[joint].translation)
    for foot in robot.feet:
        frame = model.frames[robot.frame_id(foot.frame)]
        yield int(frame.parentJoint), np.array(frame.placement.translation)
