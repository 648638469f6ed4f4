"""Functions that make terrains, from arguments and from the recipes that files hold."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, isfinite, pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from piaffe.errors import ModelError

from .base import Terrain
from .blocks import Boxes, Stairs
from .box import Box
from .heightfield import HeightField
from .numbers import require
from .planes import Flat, Incline

_MOST_NODES = 400  # of a height field: each node adds about ten operations per foot


def flat(level: float = 0.0) -> Flat:
    """Return level ground.

    Args:
        level: its height [m].
    """
    require("flat", "level", level, isfinite(level), "a finite number [m]")
    return Flat(level)


def incline(angle: float, start: float = 0.5, direction: float = 0.0) -> Incline:
    """Return a slope that begins on level ground.

    Args:
        angle: of the slope; a positive one rises [rad].
        start: distance of its start from the origin along ``direction`` [m]; −∞ for a slope everywhere, through the
            origin.
        direction: direction of the slope, an angle from the x axis [rad].
    """
    require("incline", "angle", angle, -pi / 2 < angle < pi / 2, "an angle between −π/2 and π/2 [rad]")
    require("incline", "start", start, isfinite(start) or start == -inf, "a finite number or −inf [m]")
    require("incline", "direction", direction, isfinite(direction), "a finite number [rad]")
    expected = "an angle ≥ 0, or start=-inf for a falling slope"
    require("incline", "angle", angle, angle >= 0 or start == -inf, expected)
    return Incline(float(angle), float(start), float(direction))


def stairs(
    rise: float,
    run: float,
    steps: int = 3,
    *,
    start: float = 0.5,
    direction: float = 0.0,
    width: float = 4.0,
    platform: float = 20.0,
) -> Stairs:
    """Return steps up to a platform, on a level floor.

    Args:
        rise: height of a step [m].
        run: depth of a step [m].
        steps: number of steps.
        start: distance of the first step from the origin along ``direction`` [m].
        direction: direction in which they rise, an angle from the x axis [rad].
        width: width of the stairs [m].
        platform: depth of the last step [m].
    """
    for name, value in (("rise", rise), ("run", run), ("width", width), ("platform", platform)):
        require("stairs", name, value, isfinite(value) and value > 0, "a positive number [m]")
    require("stairs", "steps", steps, steps == int(steps) and steps >= 1, "a whole number ≥ 1")
    for name, value in (("start", start), ("direction", direction)):
        require("stairs", name, value, isfinite(value), "a finite number")
    numbers = (float(value) for value in (start, direction, width, platform))
    return Stairs(float(rise), float(run), int(steps), *numbers)


def boxes(*blocks: Box) -> Boxes:
    """Return blocks on a level floor."""
    for block in blocks:
        require("boxes", "a block", block, isinstance(block, Box), "models.terrain.Box(...)")
    return Boxes(blocks)


def heightfield(heights: ArrayLike, size: tuple[float, float], centre: tuple[float, float] = (0.0, 0.0)) -> HeightField:
    """Return ground with heights at the nodes of a grid, on a level floor that continues around it.

    Each cell of the grid is two triangles, divided along its diagonal from low x and y to high x and y, as in MuJoCo.

    Args:
        heights: at the nodes, rows along y and columns along x, (r, c), each ≥ 0 and at most 400 in all [m].
        size: extent in x and y [m].
        centre: x and y of its middle [m].
    """
    grid = np.asarray(heights, dtype=float)
    fits = grid.ndim == 2 and min(grid.shape) >= 2 and grid.size <= _MOST_NODES
    require("heightfield", "shape", grid.shape, fits, f"at least (2, 2) and at most {_MOST_NODES} nodes")
    require("heightfield", "lowest height", grid.min(), np.all(np.isfinite(grid)) and grid.min() >= 0, "≥ 0 m")
    require("heightfield", "size", size, len(size) == 2 and min(size) > 0, "two lengths > 0 [m]")
    require("heightfield", "centre", centre, len(centre) == 2 and all(map(isfinite, centre)), "x and y [m]")
    rows = tuple(tuple(map(float, row)) for row in grid)
    return HeightField(rows, (float(size[0]), float(size[1])), (float(centre[0]), float(centre[1])))


def checked_terrain(terrain: object, where: str) -> Terrain:
    """Return a terrain, level ground if None; raise ModelError for anything else."""
    if terrain is None:
        return Flat()
    if not isinstance(terrain, Terrain):
        raise ModelError(
            f"{where}: terrain is unusable - got {terrain!r}, expected a Terrain; make one, as "
            "models.terrain.stairs(...)"
        )
    return terrain


def from_recipe(recipe: Mapping[str, Any]) -> Terrain:
    """Return the terrain of a recipe, which :meth:`Terrain.recipe` made."""
    numbers = {key: value for key, value in recipe.items() if key != "kind"}
    if recipe["kind"] == "incline":
        return incline(**{**numbers, "start": -inf if numbers["start"] is None else numbers["start"]})
    if recipe["kind"] == "boxes":
        return boxes(*(
            Box(**{**block, "place": tuple(block["place"]), "size": tuple(block["size"])})
            for block in numbers["blocks"]
        ))  # fmt: skip
    makers = {"flat": flat, "stairs": stairs, "heightfield": heightfield}
    require("recipe", "kind", recipe["kind"], recipe["kind"] in makers, "one that this version knows")
    made: Terrain = makers[recipe["kind"]](**numbers)  # type: ignore[operator]  # each has its own arguments
    return made
