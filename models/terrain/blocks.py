"""Terrains made of blocks on a level floor: boxes and stairs."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import reduce
from math import cos, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .base import Terrain
from .box import Box
from .numbers import FLOOR, add_plane, maximum, within

Array = NDArray[np.float64]


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
