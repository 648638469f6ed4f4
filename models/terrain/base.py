"""The base class of terrains: ground with one height at every place in the plane."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .box import Box
from .numbers import dot

Array = NDArray[np.float64]

_TINY = 1e-6  # [m²], added to the second moments of places to keep them regular; a robot's feet have more than 0.01


class Terrain(ABC):
    """Ground without overhangs: one height at every place in the plane."""

    @abstractmethod
    def height(self, x: Any, y: Any) -> Any:
        """Return the ground's height at places [m].

        Args:
            x: CasADi expressions or NumPy arrays of any shape [m].
            y: the same [m].
        """

    def slope(self, xs: Sequence[Any], ys: Sequence[Any]) -> tuple[Any, Any]:
        """Return the slopes along x and y of the plane that fits the ground at some places best.

        If the places are on one line, the plane is level across it.
        """
        return fitted_slope(xs, ys, [self.height(x, y) for x, y in zip(xs, ys, strict=True)])

    @abstractmethod
    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add the ground's geoms to the world body of a ``mujoco.MjSpec``; ``surface`` are options of each geom."""

    def mean_height(self, xs: Sequence[Any], ys: Sequence[Any]) -> Any:
        """Return the mean height of the ground at some places [m]."""
        return sum(self.height(x, y) for x, y in zip(xs, ys, strict=True)) / len(xs)

    # ---- numbers of places

    @property
    def boxes(self) -> tuple[Box, ...]:
        """The blocks whose sides a foot may hit; none by default."""
        return ()

    @abstractmethod
    def recipe(self) -> dict[str, Any]:
        """Return the values, for JSON, from which :func:`from_recipe` makes the terrain again."""

    def gradient(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the derivatives of the height by x and y at places, (...) each; by default the ground is level."""
        level = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))
        return level, level

    def clear(self, places: Array, inside: float, before: float) -> Array:
        """Return places, (..., 2) [m], moved away from edges; by default there are none.

        Args:
            places: the places.
            inside: smallest distance from an edge of what a place is on [m].
            before: smallest distance from the side of a block that a place is not on [m].
        """
        return places

    def surface(self, places: Array) -> tuple[Array, Array]:
        """Return points of the ground and its upward unit normals, (..., 3) [m] each, at places (..., 2) [m]."""
        x, y = places[..., 0], places[..., 1]
        slope = self.gradient(x, y)
        upward = np.stack([-slope[0], -slope[1], np.ones_like(slope[0])], axis=-1)
        upward = upward / np.sqrt(np.sum(upward**2, axis=-1, keepdims=True))
        return np.stack([x, y, np.asarray(self.height(x, y))], axis=-1), upward

    def standing(self, places: Array, radius: float) -> Array:
        """Return the centres of balls that touch the ground above or below places (..., 2), (..., 3) [m]."""
        centres, upward = self.surface(places)
        centres[..., 2] += radius / upward[..., 2]
        return centres


def fitted_slope(xs: Sequence[Any], ys: Sequence[Any], zs: Sequence[Any]) -> tuple[Any, Any]:
    """Return the slopes along x and y of the plane that fits points best, see :meth:`Terrain.slope`."""
    dx, dy, dz = ([value - sum(values) / len(values) for value in values] for values in (xs, ys, zs))
    xx, xy, yy = dot(dx, dx) + _TINY, dot(dx, dy), dot(dy, dy) + _TINY
    xz, yz = dot(dx, dz), dot(dy, dz)
    determinant = xx * yy - xy * xy
    return (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant
