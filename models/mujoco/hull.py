"""The hull of a robot in a MuJoCo scene: base and knees that touch the ground, so that a fallen one does not sink."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..mujoco_import import import_mujoco
from ..robot import ROOT, Robot
from .look import scale

HULL_GROUP = 4  # a viewer shows groups 0 to 2 unless told otherwise
_THIN = 0.7  # a knee's radius over the foot's


def add_hull(robot: Robot, bodies: Mapping[int, Any], surface: Mapping[str, Any]) -> None:
    """Add a box between the first joints of the legs, and a ball at each knee: joints that a link's length is above.

    Balls take three in a hundred of a step; capsules along the links would touch nothing either and take far more.

    Args:
        robot: the robot.
        bodies: the bodies of a ``mujoco.MjSpec`` by the index of their joint in the pinocchio model.
        surface: options of the geoms.
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
