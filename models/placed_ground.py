"""A terrain of the world as expressions in a frame of a controller, whose place in the world is an argument."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as cs

from .obstacles import DEEP, SAME_PLACE
from .terrain import Terrain, clear_expression, side_expression, standing_expression, surface_expression

_FAR = 1e6  # [m], in place of infinite distances

PlaneExpression = tuple[cs.SX, cs.SX]
"""A point of a plane [m] and its unit normal, which points away from the ground, (3, 1) each."""


@dataclass(frozen=True, eq=False)
class PlacedGround:
    """The ground in a planar frame; places and planes are in this frame.

    Args:
        terrain: the terrain, in the world.
        radius: of the feet [m].
        anchor: the frame in the world, (x, y, yaw), (3, 1) [m, m, rad].
    """

    terrain: Terrain
    radius: float
    anchor: cs.SX

    def height(self, place: cs.SX) -> cs.SX:
        """Return the height of the ground at a place (2, 1) [m]."""
        return surface_expression(self.terrain, self._world(place)).height

    def heights_between(self, first: cs.SX, last: cs.SX, shares: Sequence[cs.SX]) -> list[cs.SX]:
        """Return the heights of the ground on the way between two places (2, 1), at shares of it [m]."""
        start, end = self._world(first), self._world(last)
        return [surface_expression(self.terrain, start + share * (end - start)).height for share in shares]

    def surface(self, place: cs.SX) -> PlaneExpression:
        """Return the plane of the ground at a place (2, 1), as :meth:`Terrain.surface`."""
        ground = surface_expression(self.terrain, self._world(place))
        return cs.vertcat(place[:2], ground.height), self._turned_back(ground.normal)

    def standing(self, place: cs.SX) -> cs.SX:
        """Return the centre (3, 1) of a foot that stands at a place (2, 1), as :meth:`Terrain.standing`."""
        height = standing_expression(self.terrain, self._world(place), self.radius)[2]
        return cs.vertcat(place[:2], height)

    def clear(self, place: cs.SX, inside: float, before: float) -> cs.SX:
        """Return a place (2, 1) moved away from edges, as :meth:`Terrain.clear`."""
        world = self._world(place)
        moved = clear_expression(self.terrain, world, inside, before)
        return place[:2] + self._turned_back(cs.vertcat(moved - world, 0))[:2]

    def about(self, place: cs.SX) -> tuple[PlaneExpression, PlaneExpression]:
        """Return the plane above which a foot at a place (3, 1) stays, and that beside it; see ``planes_about``."""
        world = self._world(place)
        ground = surface_expression(self.terrain, world)
        top, upward, nearest = ground.height, ground.normal, cs.SX(_FAR)
        at, outwards = cs.vertcat(world, place[2] - DEEP), cs.SX([0, 0, 1])
        for box in self.terrain.boxes:
            gap, outward = side_expression(box, world)
            beside = gap >= place[2] - box.height
            nearer = cs.logic_and(beside, gap < nearest - SAME_PLACE)
            nearest = cs.if_else(nearer, gap, nearest)
            at = cs.if_else(nearer, cs.vertcat(world - gap * outward, box.height), at)
            outwards = cs.if_else(nearer, cs.vertcat(outward, 0), outwards)
            higher = cs.logic_and(1 - beside, box.height > top)
            top, upward = cs.if_else(higher, box.height, top), cs.if_else(higher, cs.SX([0, 0, 1]), upward)
        return (cs.vertcat(place[:2], top), self._turned_back(upward)), self._plane_back(at, outwards)

    def within(self, place: cs.SX) -> PlaneExpression:
        """Return the plane beside which a foot at a place (3, 1) lands; see ``obstacles.within``."""
        world, nearest = self._world(place), cs.SX(_FAR)
        at, outwards = cs.vertcat(world, place[2] - DEEP), cs.SX([0, 0, 1])
        for box in self.terrain.boxes:
            gap, outward = side_expression(box, world)
            nearer = cs.logic_and(cs.fabs(gap) >= self.radius, cs.fabs(gap) < nearest - SAME_PLACE)
            nearest = cs.if_else(nearer, cs.fabs(gap), nearest)
            at = cs.if_else(nearer, cs.vertcat(world - gap * outward, box.height), at)
            outwards = cs.if_else(nearer, cs.vertcat(cs.sign(gap) * outward, 0), outwards)
        return self._plane_back(at, outwards)

    def none_beside(self, place: cs.SX) -> PlaneExpression:
        """Return a plane that is far below a foot, as ``obstacles.none_beside``."""
        return cs.vertcat(place[:2], place[2] - DEEP), cs.SX([0, 0, 1])

    def _world(self, place: cs.SX) -> cs.SX:
        """Return x and y of a place in the world, (2, 1) [m]."""
        c, s = cs.cos(self.anchor[2]), cs.sin(self.anchor[2])
        x, y = place[0], place[1]
        return cs.vertcat(self.anchor[0] + c * x - s * y, self.anchor[1] + s * x + c * y)

    def _turned_back(self, vector: cs.SX) -> cs.SX:
        """Return a vector of the world (3, 1) in the axes of the frame."""
        c, s = cs.cos(self.anchor[2]), cs.sin(self.anchor[2])
        return cs.vertcat(c * vector[0] + s * vector[1], c * vector[1] - s * vector[0], vector[2])

    def _plane_back(self, point: cs.SX, normal: cs.SX) -> PlaneExpression:
        shifted = cs.vertcat(point[:2] - self.anchor[:2], point[2])
        return self._turned_back(shifted), self._turned_back(normal)
