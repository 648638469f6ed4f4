"""A block on the floor, of which some terrains are made."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, isfinite, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError

from ..mujoco_import import import_mujoco
from .numbers import DEPTH, STONE, within

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """A block on the floor.

    Args:
        place: x and y of its middle [m].
        size: length and width [m].
        height: of its top above z = 0 [m].
        yaw: angle of its length from the x axis [rad].
    """

    place: tuple[float, float]
    size: tuple[float, float]
    height: float
    yaw: float = 0.0

    def __post_init__(self) -> None:
        numbers = (*self.place, *self.size, self.height, self.yaw)
        if not (all(map(isfinite, numbers)) and min(*self.size, self.height) > 0):
            raise ModelError(
                f"terrain box: numbers are out of range - got place {self.place}, size {self.size}, height "
                f"{self.height}, yaw {self.yaw}, expected finite numbers, sizes and height above 0 [m]; change them"
            )

    def covers(self, x: Any, y: Any) -> Any:
        """Return 1 where the box is and 0 elsewhere."""
        along, across = self._inside(x, y)
        return within(along, self.size[0] / 2) * within(across, self.size[1] / 2)

    def side(self, places: Array) -> tuple[Array, Array]:
        """Return how far places (..., 2) are outside the nearest side, (...) [m], and its outward normal, (..., 2).

        The distance is negative inside. Outside it is that from the plane of the side that is farthest away.
        """
        own = np.stack(self._inside(places[..., 0], places[..., 1]), axis=-1)
        gaps = np.abs(own) - np.array(self.size) / 2
        lengthwise = gaps[..., 0] >= gaps[..., 1]
        outward = np.where(own >= 0, 1.0, -1.0) * np.stack([lengthwise, ~lengthwise], axis=-1)
        c, s = cos(self.yaw), sin(self.yaw)
        return np.max(gaps, axis=-1), np.asarray(outward @ np.array([[c, s], [-s, c]]))

    def _inside(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return the coordinates of places along the length and the width of the box, from its middle [m]."""
        ahead, aside = x - self.place[0], y - self.place[1]
        return (
            cos(self.yaw) * ahead + sin(self.yaw) * aside,
            cos(self.yaw) * aside - sin(self.yaw) * ahead,
        )

    def add_to(self, spec: Any, name: str, surface: dict[str, Any]) -> None:
        """Add the box; it reaches below the floor, so that a geom that penetrates it is pushed up and not sideways."""
        tall = (self.height + DEPTH) / 2
        spec.worldbody.add_geom(
            name=name, type=import_mujoco().mjtGeom.mjGEOM_BOX, pos=(*self.place, self.height - tall),
            quat=(cos(self.yaw / 2), 0.0, 0.0, sin(self.yaw / 2)), size=(self.size[0] / 2, self.size[1] / 2, tall),
            **{"rgba": STONE, **surface},
        )  # fmt: skip
