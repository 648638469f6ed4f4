"""Terrains made of planes: level ground and slopes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, inf, sin, tan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .base import Terrain
from .numbers import FLOOR, STONE, add_plane, is_symbolic, maximum

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Flat(Terrain):
    """Level ground; made by :func:`flat`.

    Args:
        level: its height [m]; a number, or an expression (used by models).
    """

    level: Any = 0.0

    def height(self, x: Any, y: Any) -> Any:
        """Return the level [m]."""
        return self.level if is_symbolic(x) else np.full(np.broadcast_shapes(np.shape(x), np.shape(y)), self.level)

    def mean_height(self, xs: Sequence[Any], ys: Sequence[Any]) -> Any:
        """Return the level [m]."""
        return self.height(xs[0], ys[0])

    def slope(self, xs: Sequence[Any], ys: Sequence[Any]) -> tuple[Any, Any]:
        """Return zeros."""
        return 0.0, 0.0

    def recipe(self) -> dict[str, Any]:
        """Return the kind of terrain and its level."""
        return {"kind": "flat", "level": float(self.level)}

    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add a plane."""
        add_plane(spec, FLOOR, (0.0, 0.0, float(self.level)), surface)


@dataclass(frozen=True)
class Incline(Terrain):
    """A slope; made by :func:`incline`."""

    angle: float
    start: float
    direction: float

    def height(self, x: Any, y: Any) -> Any:
        """Return the height of the slope, or of the level ground before it [m]."""
        along = cos(self.direction) * x + sin(self.direction) * y
        if self.start == -inf:
            return tan(self.angle) * along
        return maximum(tan(self.angle) * (along - self.start), 0.0)

    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add a tilted plane and, if the slope has a start, a level one; the ground is what is below either plane."""
        reach = 0.0 if self.start == -inf else self.start
        place = (reach * cos(self.direction), reach * sin(self.direction), 0.0)
        half, turn = -self.angle / 2, self.direction / 2
        tilted = (cos(turn) * cos(half), -sin(turn) * sin(half), cos(turn) * sin(half), sin(turn) * cos(half))
        if self.start == -inf:
            add_plane(spec, FLOOR, place, surface, tilted)
        else:
            add_plane(spec, FLOOR, (0.0, 0.0, 0.0), surface)
            add_plane(spec, "slope", place, {"rgba": STONE, **surface}, tilted)

    def recipe(self) -> dict[str, Any]:
        """Return the kind of terrain and its numbers; no start for a slope everywhere."""
        start = None if self.start == -inf else self.start
        return {"kind": "incline", "angle": self.angle, "start": start, "direction": self.direction}

    def gradient(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the derivatives of the height by x and y."""
        along = cos(self.direction) * x + sin(self.direction) * y
        rises = tan(self.angle) * np.where(along >= self.start, 1.0, 0.0)
        return cos(self.direction) * rises, sin(self.direction) * rises

    def clear(self, places: Array, inside: float, before: float) -> Array:
        """Return places moved away from the line at which the slope begins."""
        if self.start == -inf:
            return places
        ahead = np.array([cos(self.direction), sin(self.direction)])
        along = places @ ahead - self.start
        wanted = np.where(along >= 0, np.maximum(along, inside), np.minimum(along, -inside))
        return np.asarray(places + (wanted - along)[..., None] * ahead)
