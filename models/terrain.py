"""Terrains: the height of the ground as CasADi expressions and NumPy arrays, and the same ground as MuJoCo geoms."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from math import cos, inf, isfinite, pi, sin, tan
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import ArrayLike

from piaffe.errors import ModelError

from .mujoco_import import import_mujoco

FLOOR = "floor"
"""Name of the ground's geom in MuJoCo scenes."""

_DEPTH = 0.3  # [m], how far boxes reach below the floor
_STONE = (0.72, 0.74, 0.78, 1.0)
_TINY = 1e-6  # [m²], added to the second moments of places to keep them regular; a robot's feet have more than 0.01
_MOST_NODES = 400  # of a height field: each node adds about ten operations per foot


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
        zs = [self.height(x, y) for x, y in zip(xs, ys, strict=True)]
        dx, dy, dz = ([value - sum(values) / len(values) for value in values] for values in (xs, ys, zs))
        xx, xy, yy = _dot(dx, dx) + _TINY, _dot(dx, dy), _dot(dy, dy) + _TINY
        xz, yz = _dot(dx, dz), _dot(dy, dz)
        determinant = xx * yy - xy * xy
        return (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant

    @abstractmethod
    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add the ground's geoms to the world body of a ``mujoco.MjSpec``; ``surface`` are options of each geom."""

    def mean_height(self, xs: Sequence[Any], ys: Sequence[Any]) -> Any:
        """Return the mean height of the ground at some places [m]."""
        return sum(self.height(x, y) for x, y in zip(xs, ys, strict=True)) / len(xs)


@dataclass(frozen=True)
class Flat(Terrain):
    """Level ground; made by :func:`flat`.

    Args:
        level: its height [m]; a number, or an expression (used by models).
    """

    level: Any = 0.0

    def height(self, x: Any, y: Any) -> Any:
        """Return the level [m]."""
        return self.level if _is_symbolic(x) else np.full(np.broadcast_shapes(np.shape(x), np.shape(y)), self.level)

    def mean_height(self, xs: Sequence[Any], ys: Sequence[Any]) -> Any:
        """Return the level [m]."""
        return self.height(xs[0], ys[0])

    def slope(self, xs: Sequence[Any], ys: Sequence[Any]) -> tuple[Any, Any]:
        """Return zeros."""
        return 0.0, 0.0

    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add a plane."""
        _add_plane(spec, FLOOR, (0.0, 0.0, float(self.level)), surface)


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
        return _maximum(tan(self.angle) * (along - self.start), 0.0)

    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add a tilted plane and, if the slope has a start, a level one; the ground is what is below either plane."""
        reach = 0.0 if self.start == -inf else self.start
        place = (reach * cos(self.direction), reach * sin(self.direction), 0.0)
        half, turn = -self.angle / 2, self.direction / 2
        tilted = (cos(turn) * cos(half), -sin(turn) * sin(half), cos(turn) * sin(half), sin(turn) * cos(half))
        if self.start == -inf:
            _add_plane(spec, FLOOR, place, surface, tilted)
        else:
            _add_plane(spec, FLOOR, (0.0, 0.0, 0.0), surface)
            _add_plane(spec, "slope", place, {"rgba": _STONE, **surface}, tilted)


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
        ahead, aside = x - self.place[0], y - self.place[1]
        along = cos(self.yaw) * ahead + sin(self.yaw) * aside
        across = cos(self.yaw) * aside - sin(self.yaw) * ahead
        return _within(along, self.size[0] / 2) * _within(across, self.size[1] / 2)

    def add_to(self, spec: Any, name: str, surface: dict[str, Any]) -> None:
        """Add the box; it reaches below the floor, so that a geom that penetrates it is pushed up and not sideways."""
        tall = (self.height + _DEPTH) / 2
        spec.worldbody.add_geom(
            name=name, type=import_mujoco().mjtGeom.mjGEOM_BOX, pos=(*self.place, self.height - tall),
            quat=(cos(self.yaw / 2), 0.0, 0.0, sin(self.yaw / 2)), size=(self.size[0] / 2, self.size[1] / 2, tall),
            **{"rgba": _STONE, **surface},
        )  # fmt: skip


@dataclass(frozen=True)
class Boxes(Terrain):
    """Blocks on a level floor; made by :func:`boxes`."""

    blocks: tuple[Box, ...]

    def height(self, x: Any, y: Any) -> Any:
        """Return the top of the highest box at a place; 0 where there is none [m]."""
        tops = [box.height * box.covers(x, y) for box in self.blocks]
        return reduce(_maximum, tops, 0.0 * x)

    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add the floor and the boxes."""
        _add_plane(spec, FLOOR, (0.0, 0.0, 0.0), surface)
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
        return self.rise * climbed * (along <= self._end) * _within(across, self.width / 2)

    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add the floor and a box per step."""
        Boxes(tuple(map(self._box, range(self.steps)))).add_to(spec, **surface)

    @property
    def _end(self) -> float:
        return self.start + (self.steps - 1) * self.run + self.platform

    def _box(self, step: int) -> Box:
        first = self.start + step * self.run
        last = self._end if step == self.steps - 1 else first + self.run
        middle = (first + last) / 2
        place = (middle * cos(self.direction), middle * sin(self.direction))
        return Box(place, (last - first, self.width), self.rise * (step + 1), self.direction)


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
                spread = _maximum(_maximum(a, b), 0.0) + _maximum(_maximum(-a, -b), 0.0)
                total = total + node * _maximum(1.0 - spread, 0.0)
        return total * _within(ahead, self.size[0] / 2) * _within(aside, self.size[1] / 2)

    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add the floor and a height field on it."""
        _add_plane(spec, FLOOR, (0.0, 0.0, 0.0), surface)
        grid = np.array(self.heights)
        low, high = float(grid.min()), float(grid.max())
        if high > low:
            spec.add_hfield(
                name="field", nrow=len(grid), ncol=len(grid[0]), userdata=grid.ravel(),
                size=(self.size[0] / 2, self.size[1] / 2, high - low, _DEPTH),
            )  # fmt: skip
            kind = {"type": import_mujoco().mjtGeom.mjGEOM_HFIELD, "hfieldname": "field", "pos": (*self.centre, low)}
            spec.worldbody.add_geom(name="field", rgba=_STONE, **kind, **surface)
        elif high > 0:
            Box(self.centre, self.size, high).add_to(spec, "field", surface)


# ---- constructors


def flat(level: float = 0.0) -> Flat:
    """Return level ground.

    Args:
        level: its height [m].
    """
    _require("flat", "level", level, isfinite(level), "a finite number [m]")
    return Flat(level)


def incline(angle: float, start: float = 0.5, direction: float = 0.0) -> Incline:
    """Return a slope that begins on level ground.

    Args:
        angle: of the slope; a positive one rises [rad].
        start: distance of its start from the origin along ``direction`` [m]; −∞ for a slope everywhere, through the
            origin.
        direction: direction of the slope, an angle from the x axis [rad].
    """
    _require("incline", "angle", angle, -pi / 2 < angle < pi / 2, "an angle between −π/2 and π/2 [rad]")
    _require("incline", "start", start, isfinite(start) or start == -inf, "a finite number or −inf [m]")
    _require("incline", "direction", direction, isfinite(direction), "a finite number [rad]")
    expected = "an angle ≥ 0, or start=-inf for a falling slope"
    _require("incline", "angle", angle, angle >= 0 or start == -inf, expected)
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
        _require("stairs", name, value, isfinite(value) and value > 0, "a positive number [m]")
    _require("stairs", "steps", steps, steps == int(steps) and steps >= 1, "a whole number ≥ 1")
    for name, value in (("start", start), ("direction", direction)):
        _require("stairs", name, value, isfinite(value), "a finite number")
    numbers = (float(value) for value in (start, direction, width, platform))
    return Stairs(float(rise), float(run), int(steps), *numbers)


def boxes(*blocks: Box) -> Boxes:
    """Return blocks on a level floor."""
    for block in blocks:
        _require("boxes", "a block", block, isinstance(block, Box), "models.terrain.Box(...)")
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
    _require("heightfield", "shape", grid.shape, fits, f"at least (2, 2) and at most {_MOST_NODES} nodes")
    _require("heightfield", "lowest height", grid.min(), np.all(np.isfinite(grid)) and grid.min() >= 0, "≥ 0 m")
    _require("heightfield", "size", size, len(size) == 2 and min(size) > 0, "two lengths > 0 [m]")
    _require("heightfield", "centre", centre, len(centre) == 2 and all(map(isfinite, centre)), "x and y [m]")
    rows = tuple(tuple(map(float, row)) for row in grid)
    return HeightField(rows, (float(size[0]), float(size[1])), (float(centre[0]), float(centre[1])))


# ---- helpers for both expressions and arrays


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _is_symbolic(value: Any) -> bool:
    return isinstance(value, cs.SX | cs.MX | cs.DM)


def _maximum(a: Any, b: Any) -> Any:
    return cs.fmax(a, b) if _is_symbolic(a) or _is_symbolic(b) else np.maximum(a, b)


def _within(value: Any, half: float) -> Any:
    return (value >= -half) * (value <= half)


def _add_plane(
    spec: Any, name: str, place: Sequence[float], surface: dict[str, Any], quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0)
) -> None:
    """Add an infinite plane."""
    kind = import_mujoco().mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(name=name, type=kind, pos=place, quat=quat, size=(0, 0, 0.05), **surface)


def _require(terrain: str, what: str, got: Any, holds: Any, expected: str) -> None:
    if not holds:
        raise ModelError(f"terrain {terrain}: {what} is out of range - got {got!r}, expected {expected}; change it")
