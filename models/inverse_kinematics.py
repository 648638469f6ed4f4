"""Joint angles from the places of feet, and back, for keyframes and states that are declared by where the feet are."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError, ShapeError
from piaffe.ocp import rotation

from .kinematics import Kinematics
from .robot import Robot

Array = NDArray[np.float64]

REACHED = 1e-4
"""A foot that is farther from its place than this is out of reach [m]."""


def inverse_kinematics(
    robot: Robot,
    feet: Mapping[str, ArrayLike],
    position: ArrayLike = (0.0, 0.0, 0.0),
    rpy: ArrayLike = (0.0, 0.0, 0.0),
    joints: object = "stand",
    where: str | None = None,
) -> Array:
    """Return the joint angles, (n,) [rad], see :meth:`Robot.inverse_kinematics`."""
    where = where or f"robot '{robot.name}', inverse kinematics"
    at, turned = _three(position, f"{where}, position", "m"), _three(rpy, f"{where}, rpy", "rad")
    start = robot.pose(joints)
    if not isinstance(feet, Mapping):
        raise ModelError(
            f"{where}: feet is unusable - got {feet!r}, expected a mapping of names to places; write "
            f'{{"{(robot.foot_names or ("FL",))[0]}": (x, y, z)}}'
        )
    kinematics, orientation = Kinematics(robot), rotation.np_from_rpy(turned)
    wanted = kinematics.world_feet(at, orientation, start)
    for name, place in feet.items():
        wanted[robot.foot_names.index(robot.foot(name).name)] = _three(place, f"{where}, foot '{name}'", "m")
    angles, errors = kinematics.world_inverse(at, orientation, wanted, start)
    for name in feet:
        index = robot.foot_names.index(name)
        if not errors[index] <= REACHED:
            place = kinematics.world_feet(at, orientation, angles)[index]
            raise ModelError(
                f"{where}: foot '{name}' is out of reach - got {wanted[index].round(4).tolist()} m, the nearest place "
                f"within the joint limits is {place.round(4).tolist()} m, expected one within {1e3 * REACHED:g} mm; "
                "move the foot or the base, or start from a pose whose knees bend to the other side"
            )
    moved = sorted({joint for name in feet for joint in _joints_of(kinematics, robot.foot_names.index(name))})
    start[moved] = angles[moved]  # legs that are not named keep their angles to the last bit
    return start


def forward_kinematics(robot: Robot, joints: object, position: ArrayLike | None, rpy: ArrayLike) -> dict[str, Array]:
    """Return the places of the feet, name → (3,) [m], see :meth:`Robot.forward_kinematics`."""
    where = f"robot '{robot.name}', forward kinematics"
    at = np.zeros(3) if position is None else _three(position, f"{where}, position", "m")
    orientation = rotation.np_from_rpy(_three(rpy, f"{where}, rpy", "rad"))
    places: Array = Kinematics(robot).world_feet(at, orientation, robot.pose(joints))
    if position is None and robot.base == "free" and robot.feet:
        places[:, 2] += robot.foot_radius - places[:, 2].min()
    return dict(zip(robot.foot_names, places, strict=True))


def _joints_of(kinematics: Kinematics, foot: int) -> list[int]:
    for legs in kinematics.groups:
        if foot in legs.feet:
            return [int(joint) for joint in legs.joints[list(legs.feet).index(foot)]]
    return []


def _three(value: ArrayLike, where: str, unit: str) -> Array:
    array: Array = np.asarray(value, dtype=float)
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise ShapeError(f"{where}: is unusable - got {value!r}, expected three finite numbers [{unit}]; give them")
    return array
