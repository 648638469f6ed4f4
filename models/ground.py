"""The ground below the feet as expressions: the terrain itself, or a plane per foot in numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as cs
import numpy as np

from .terrain import Flat, Terrain, fitted_slope

SLOTS = ("surfaces", "normals")
"""Slots of the planes, in the order of :class:`Planes`."""


class Ground(ABC):
    """The ground below the feet, whose centres are given as expressions, (3, 1) each."""

    kept: tuple[str, ...] = ("",)
    """What the entries of ``feet.clearance`` keep feet away from; empty for where they stand."""

    @abstractmethod
    def gaps(self, places: Sequence[cs.SX], radius: cs.SX) -> list[cs.SX]:
        """Return the distance of each foot's ball from the ground where it stands [m]."""

    @abstractmethod
    def mean_height(self, places: Sequence[cs.SX]) -> Any:
        """Return the mean height of the ground below the feet [m]."""

    @abstractmethod
    def slope(self, places: Sequence[cs.SX]) -> tuple[Any, Any]:
        """Return the slopes along x and y of the plane that fits the ground below the feet."""

    def other_clearances(self, places: Sequence[cs.SX], radius: cs.SX) -> list[cs.SX]:
        """Return the distances that feet in the air keep beside :meth:`gaps`; by default none."""
        return []

    def in_contact_axes(self, vectors: Sequence[cs.SX]) -> list[cs.SX]:
        """Return a vector per foot in the axes of its contact, the normal last; by default those of the world."""
        return list(vectors)

    def normals(self, count: int) -> list[Any]:
        """Return the upward unit normal of each foot's contact, (3, 1); by default the vertical."""
        return [cs.SX([0, 0, 1])] * count


class Exact(Ground):
    """A terrain; heights are vertical distances from it.

    Args:
        terrain: the terrain.
    """

    def __init__(self, terrain: Terrain) -> None:
        self.terrain = terrain

    def gaps(self, places: Sequence[cs.SX], radius: cs.SX) -> list[cs.SX]:
        """Return the height of each foot's ball."""
        return [place[2] - self.terrain.height(place[0], place[1]) - radius for place in places]

    def mean_height(self, places: Sequence[cs.SX]) -> Any:
        """Return the mean height of the ground below the feet [m]."""
        return self.terrain.mean_height(*_split(places))

    def slope(self, places: Sequence[cs.SX]) -> tuple[Any, Any]:
        """Return the slopes along x and y of the plane that fits the ground below the feet."""
        return self.terrain.slope(*_split(places))


class Planes(Ground):
    """Planes: where each foot stands, what is below it and what is beside it, see ``feet.surfaces``.

    Args:
        surfaces: a point of each plane: nf of the ground, nf below and nf beside the feet, (9 nf, 1) [m].
        normals: their unit normals, (9 nf, 1).
    """

    kept = ("", "over", "beside")

    def __init__(self, surfaces: cs.SX, normals: cs.SX) -> None:
        planes = list(zip(cs.vertsplit(surfaces, 3), cs.vertsplit(normals, 3), strict=True))
        count = len(planes) // 3
        self._ground, self._over, self._beside = planes[:count], planes[count : 2 * count], planes[2 * count :]

    def gaps(self, places: Sequence[cs.SX], radius: cs.SX) -> list[cs.SX]:
        """Return the distance of each foot's ball from the plane on which it stands."""
        return _distances(self._ground, places, radius)

    def other_clearances(self, places: Sequence[cs.SX], radius: cs.SX) -> list[cs.SX]:
        """Return the distances from the planes below the feet, and from those beside them."""
        return [*_distances(self._over, places, radius), *_distances(self._beside, places, radius)]

    def mean_height(self, places: Sequence[cs.SX]) -> Any:
        """Return the mean height of the planes below or above the feet [m]."""
        return sum(self._heights(places)) / len(places)

    def slope(self, places: Sequence[cs.SX]) -> tuple[Any, Any]:
        """Return the slopes along x and y of the plane that fits these heights."""
        return fitted_slope(*_split(places), self._heights(places))

    def in_contact_axes(self, vectors: Sequence[cs.SX]) -> list[cs.SX]:
        """Return a vector per foot in axes that the smallest rotation turns from the world's onto its plane."""
        return [contact_axes(normal).T @ vector for (_, normal), vector in zip(self._ground, vectors, strict=True)]

    def normals(self, count: int) -> list[Any]:
        """Return the normals of the planes on which the feet stand."""
        return [normal for _, normal in self._ground]

    def _heights(self, places: Sequence[cs.SX]) -> list[cs.SX]:
        return [
            point[2] - cs.dot(normal[:2], place[:2] - point[:2]) / normal[2]
            for (point, normal), place in zip(self._ground, places, strict=True)
        ]


def declared_ground(terrain: Terrain, p: Mapping[str, cs.SX]) -> Ground:
    """Return the ground of a model's slots: level at the slot ``terrain``, or the planes of other terrains."""
    return Exact(Flat(p["terrain"])) if isinstance(terrain, Flat) else Planes(p["surfaces"], p["normals"])


def contact_axes(normal: cs.SX) -> cs.SX:
    """Return the matrix of the axes of a contact as columns, (3, 3): x and y of the world turned with the vertical.

    For a normal n the columns are the smallest rotation from (0, 0, 1) to n; n must not point down.
    """
    a, b, c = cs.vertsplit(normal)
    share = 1 / (1 + c)
    return cs.vertcat(
        cs.horzcat(1 - share * a**2, -share * a * b, a),
        cs.horzcat(-share * a * b, 1 - share * b**2, b),
        cs.horzcat(-a, -b, c),
    )


def ground_slots(terrain: Terrain, num_feet: int) -> dict[str, Any]:
    """Return the slots of a ground and their defaults; those of flat ground are its level alone."""
    if isinstance(terrain, Flat):
        return {"terrain": terrain.level}
    return {"surfaces": np.zeros(9 * num_feet), "normals": np.tile([0.0, 0.0, 1.0], 3 * num_feet)}


def _distances(planes: Sequence[tuple[cs.SX, cs.SX]], places: Sequence[cs.SX], radius: cs.SX) -> list[cs.SX]:
    return [cs.dot(normal, place - point) - radius for (point, normal), place in zip(planes, places, strict=True)]


def _split(places: Sequence[cs.SX]) -> tuple[list[cs.SX], list[cs.SX]]:
    return [place[0] for place in places], [place[1] for place in places]
