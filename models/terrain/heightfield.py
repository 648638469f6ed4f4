"""Terrains with heights at the nodes of a grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..mujoco_import import import_mujoco
from .base import Terrain
from .box import Box
from .numbers import DEPTH, FLOOR, STONE, add_plane, maximum, within

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeightField(Terrain):
    """Ground with heights at the nodes of a grid, linear between them; made by :func:`heightfield`."""

    heights: tuple[tuple[float, ...], ...]
    size: tuple[float, float]
    centre: tuple[float, float]

    def height(self, x: Any, y: Any) -> Any:
        """Return the height at a place, 0 outside the grid [m]: a sum of hat functions on MuJoCo's triangles."""
        grid = np.array(self.heights)
        rows, columns = grid.shape
        ahead, aside = x - self.centre[0], y - self.centre[1]
        column = (ahead / self.size[0] + 0.5) * (columns - 1)
        row = (aside / self.size[1] + 0.5) * (rows - 1)
        total = 0.0 * x
        for (i, j), node in np.ndenumerate(grid):
            if node:
                a, b = column - j, row - i
                spread = maximum(maximum(a, b), 0.0) + maximum(maximum(-a, -b), 0.0)
                total = total + node * maximum(1.0 - spread, 0.0)
        return total * within(ahead, self.size[0] / 2) * within(aside, self.size[1] / 2)

    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add the floor and a height field on it."""
        add_plane(spec, FLOOR, (0.0, 0.0, 0.0), surface)
        grid = np.array(self.heights)
        low, high = float(grid.min()), float(grid.max())
        if high > low:
            spec.add_hfield(
                name="field", nrow=len(grid), ncol=len(grid[0]), userdata=grid.ravel(),
                size=(self.size[0] / 2, self.size[1] / 2, high - low, DEPTH),
            )  # fmt: skip
            kind = {"type": import_mujoco().mjtGeom.mjGEOM_HFIELD, "hfieldname": "field", "pos": (*self.centre, low)}
            spec.worldbody.add_geom(name="field", rgba=STONE, **kind, **surface)
        elif high > 0:
            Box(self.centre, self.size, high).add_to(spec, "field", surface)

    def recipe(self) -> dict[str, Any]:
        """Return the kind of terrain, its heights, size and place."""
        heights = [list(row) for row in self.heights]
        return {"kind": "heightfield", "heights": heights, "size": list(self.size), "centre": list(self.centre)}

    def gradient(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the derivatives of the height by x and y: those of the triangle at a place; 0 outside the grid."""
        grid = np.array(self.heights)
        rows, columns = grid.shape
        ahead, aside = np.broadcast_arrays(np.asarray(x) - self.centre[0], np.asarray(y) - self.centre[1])
        column = (ahead / self.size[0] + 0.5) * (columns - 1)
        row = (aside / self.size[1] + 0.5) * (rows - 1)
        j = np.clip(np.floor(column).astype(int), 0, columns - 2)
        i = np.clip(np.floor(row).astype(int), 0, rows - 2)
        low, right, up, far = grid[i, j], grid[i, j + 1], grid[i + 1, j], grid[i + 1, j + 1]
        lower = column - j >= row - i  # the triangle below the diagonal from low x and y to high x and y
        inside = (np.abs(ahead) <= self.size[0] / 2) & (np.abs(aside) <= self.size[1] / 2)
        along = np.where(lower, right - low, far - up) * (columns - 1) / self.size[0]
        across = np.where(lower, far - right, up - low) * (rows - 1) / self.size[1]
        return np.where(inside, along, 0.0), np.where(inside, across, 0.0)
