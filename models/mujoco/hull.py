"""Collision geoms of base and knees in a MuJoCo scene, so that a fallen robot does not sink into the ground."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..mujoco_import import import_mujoco
from ..robot import ROOT, Robot
from .look import scale

HULL_GROUP = 4  # by default a viewer shows groups 0 to 2
_THIN = 0.7  # ratio of a knee's radius to a foot's


def add_hull(robot: Robot, bodies: Mapping[int, Any], surface: Mapping[str, Any]) -> None:
    """Add a box between the first joints of the legs, and a ball at each knee.

    A knee is a joint of a leg whose distance from its parent joint exceeds two diameters of the ball. The balls take
    3 % of the time of a step. Capsules along the links would make no other contacts, and would take much more time.

    Args:
        robot: the robot.
        bodies: the bodies of a ``mujoco.MjSpec`` by the index of their joint in the pinocchio model.
        surface: contact options of the geoms.
    """
    types, look = import_mujoco().mjtGeom, {"group": HULL_GROUP, "contype": 0, "conaffinity": 1, **surface}
    thick = max(_THIN * robot.foot_radius, 0.01 * scale(robot))
    model = robot.model
    places = {j: np.array(model.jointPlacements[j].translation) for j in range(ROOT + 1, model.njoints)}
    hips = np.array([place for j, place in places.items() if model.parents[j] == ROOT])
    if len(hips):
        middle, half = (hips.max(axis=0) + hips.min(axis=0)) / 2, np.ptp(hips, axis=0) / 2
        bodies[ROOT].add_geom(
            name="base hull", type=types.mjGEOM_BOX, pos=middle, size=np.maximum(half, 2 * thick), **look
        )
    for j, place in places.items():
        if model.parents[j] != ROOT and np.linalg.norm(place) > 4 * thick:
            bodies[j].add_geom(name=f"{model.names[j]} hull", type=types.mjGEOM_SPHERE, size=(thick, 0, 0), **look)
