"""Terrains made of blocks on a level floor: boxes and stairs."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import reduce
from math import cos, isfinite, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError

from ..mujoco_import import import_mujoco
from .base import Terrain
from .numbers import DEPTH, FLOOR, STONE, add_plane, maximum, within

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


@dataclass(frozen=True)
class Boxes(Terrain):
    """Blocks on a level floor; made by :func:`boxes`."""

    blocks: tuple[Box, ...]

    @property
    def boxes(self) -> tuple[Box, ...]:
        """The blocks."""
        return self.blocks

    def recipe(self) -> dict[str, Any]:
        """Return the kind of terrain and the numbers of its blocks."""
        return {"kind": "boxes", "blocks": [asdict(box) for box in self.blocks]}

    def clear(self, places: Array, inside: float, before: float) -> Array:
        """Return places moved away from the sides of the blocks."""
        return clear_of(self.blocks, places, inside, before)

    def height(self, x: Any, y: Any) -> Any:
        """Return the top of the highest box at a place; 0 where there is none [m]."""
        tops = [box.height * box.covers(x, y) for box in self.blocks]
        return reduce(maximum, tops, 0.0 * x)

    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add the floor and the boxes."""
        add_plane(spec, FLOOR, (0.0, 0.0, 0.0), surface)
        for i, box in enumerate(self.blocks):
            box.add_to(spec, f"box {i}", surface)


@dataclass(frozen=True)
class Stairs(Terrain):
    """Steps up to a platform; made by :func:`stairs`."""

    rise: float
    run: float
    steps: int
    start: float
    direction: float
    width: float
    platform: float

    def height(self, x: Any, y: Any) -> Any:
        """Return the height of the step at a place; 0 where there is none [m]."""
        c, s = cos(self.direction), sin(self.direction)
        along, across = c * x + s * y, c * y - s * x
        climbed = sum(along >= self.start + i * self.run for i in range(self.steps))
        return self.rise * climbed * (along <= self._end) * within(across, self.width / 2)

    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add the floor and a box per step."""
        Boxes(self.boxes).add_to(spec, **surface)

    @property
    def boxes(self) -> tuple[Box, ...]:
        """A block per step; the last one is the platform."""
        return tuple(map(self._box, range(self.steps)))

    def recipe(self) -> dict[str, Any]:
        """Return the kind of terrain and its numbers."""
        return {"kind": "stairs", **asdict(self)}

    def clear(self, places: Array, inside: float, before: float) -> Array:
        """Return places moved away from the sides of the steps."""
        return clear_of(self.boxes, places, inside, before)

    @property
    def _end(self) -> float:
        return self.start + (self.steps - 1) * self.run + self.platform

    def _box(self, step: int) -> Box:
        first = self.start + step * self.run
        last = self._end if step == self.steps - 1 else first + self.run
        middle = (first + last) / 2
        place = (middle * cos(self.direction), middle * sin(self.direction))
        return Box(place, (last - first, self.width), self.rise * (step + 1), self.direction)


def clear_of(boxes: tuple[Box, ...], places: Array, inside: float, before: float) -> Array:
    """Return places (..., 2) moved away from the sides of boxes, see :meth:`Terrain.clear`."""
    for box in boxes:
        gap, outward = box.side(places)
        wanted = np.where(gap >= 0, np.maximum(gap, before), np.minimum(gap, -inside))
        places = places + (wanted - gap)[..., None] * outward
    return places
