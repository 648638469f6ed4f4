"""The surfaces that a swinging foot keeps away from: the one below it, and the side of a block beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .terrain import Terrain

Array = NDArray[np.float64]
Plane = tuple[Array, Array]
"""A point of a plane [m] and its unit normal, which points away from the ground, (3,) each."""

SAME_PLACE = 1e-9
"""Sides whose distances differ by less are equally near: the first of them counts [m]. Steps share their edges."""
DEEP = 1.0
"""How far the plane is below a foot beside which there is nothing [m]."""


def planes_about(terrain: Terrain, place: Array, radius: float) -> tuple[Plane, Plane]:
    """Return the plane above which a foot stays, and the one beside which it stays.

    Which side of a block the foot stays on follows from where its reference is: beside a block if its ball is farther
    from the block's side than above the block's top, or less deep in it, else above it. So one plane for each of the
    two is enough, and they are numbers.

    Args:
        terrain: the ground.
        place: reference of the foot's centre, (3,) [m].
        radius: of the foot's ball [m].
    """
    points, normals = terrain.surface(place[None, :2])
    over, beside = (points[0], normals[0]), none_beside(place)
    nearest = np.inf
    for box in terrain.boxes:
        gap, outward = (each[0] for each in box.side(place[None, :2]))
        if gap >= place[2] - box.height:
            if gap < nearest - SAME_PLACE:
                nearest = gap
                side = place[:2] - gap * outward
                beside = np.array([*side, box.height]), np.array([*outward, 0.0])
        elif box.height > over[0][2]:
            over = np.array([*place[:2], box.height]), np.array([0.0, 0.0, 1.0])
    return over, beside


def within(terrain: Terrain, place: Array, radius: float) -> Plane:
    """Return the plane beside which a foot lands, so that its whole ball is on the surface of its reference.

    Args:
        terrain: the ground.
        place: reference of the foot's centre where it lands, (3,) [m].
        radius: of the foot's ball [m].
    """
    found, nearest = none_beside(place), np.inf
    for box in terrain.boxes:
        gap, outward = (each[0] for each in box.side(place[None, :2]))
        if abs(gap) >= radius and abs(gap) < nearest - SAME_PLACE:
            nearest = abs(gap)
            side = place[:2] - gap * outward
            found = np.array([*side, box.height]), np.array([*(np.sign(gap) * outward), 0.0])
    return found


def none_beside(place: Array) -> Plane:
    """Return a plane that is far below a foot."""
    return np.array([*place[:2], place[2] - DEEP]), np.array([0.0, 0.0, 1.0])
