"""Terrains as CasADi expressions of a place: the numbers of their methods for arrays, without their loops over places.

``height`` of a terrain takes expressions itself. That of a height field adds ten operations per node; here four do.
"""

from __future__ import annotations

from math import cos, inf, sin
from typing import NamedTuple

import casadi as cs
import numpy as np

from .base import Terrain
from .box import Box
from .heightfield import HeightField
from .numbers import within
from .planes import Incline


class SurfaceExpression(NamedTuple):
    """The ground at a place: its height [m] and its derivatives by x and y."""

    height: cs.SX
    ahead: cs.SX
    aside: cs.SX

    @property
    def normal(self) -> cs.SX:
        """The upward unit normal, (3, 1)."""
        upward = cs.vertcat(-self.ahead, -self.aside, 1)
        return upward / cs.sqrt(cs.sumsqr(upward))


def surface_expression(terrain: Terrain, place: cs.SX) -> SurfaceExpression:
    """Return the ground at a place (2, 1) [m], as :meth:`Terrain.height` and :meth:`Terrain.gradient`."""
    if isinstance(terrain, HeightField):
        return _of_field(terrain, place)
    x, y = cs.SX.sym("x"), cs.SX.sym("y")
    height = cs.SX(terrain.height(x, y))
    values = [height, cs.jacobian(height, x), cs.jacobian(height, y)]
    return SurfaceExpression(*cs.substitute([cs.densify(value) for value in values], [x, y], cs.vertsplit(place)))


def standing_expression(terrain: Terrain, place: cs.SX, radius: float) -> cs.SX:
    """Return the centre (3, 1) of a ball that touches the ground at a place, as :meth:`Terrain.standing`."""
    ground = surface_expression(terrain, place)
    return cs.vertcat(place, ground.height + radius / ground.normal[2])


def side_expression(box: Box, place: cs.SX) -> tuple[cs.SX, cs.SX]:
    """Return how far a place is outside the nearest side of a box, and its outward normal, as :meth:`Box.side`."""
    c, s = cos(box.yaw), sin(box.yaw)
    ahead, aside = place[0] - box.place[0], place[1] - box.place[1]
    own = (c * ahead + s * aside, c * aside - s * ahead)
    gaps = [cs.fabs(value) - half / 2 for value, half in zip(own, box.size, strict=True)]
    lengthwise = gaps[0] >= gaps[1]
    along = cs.if_else(own[0] >= 0, 1, -1) * lengthwise
    across = cs.if_else(own[1] >= 0, 1, -1) * (1 - lengthwise)
    return cs.fmax(*gaps), cs.vertcat(c * along - s * across, s * along + c * across)


def clear_expression(terrain: Terrain, place: cs.SX, inside: float, before: float) -> cs.SX:
    """Return a place (2, 1) [m] moved away from edges, as :meth:`Terrain.clear`."""
    if isinstance(terrain, Incline):
        if terrain.start == -inf:
            return place
        ahead = cs.SX([cos(terrain.direction), sin(terrain.direction)])
        along = cs.dot(ahead, place) - terrain.start
        wanted = cs.if_else(along >= 0, cs.fmax(along, inside), cs.fmin(along, -inside))
        return place + (wanted - along) * ahead
    for box in terrain.boxes:
        gap, outward = side_expression(box, place)
        wanted = cs.if_else(gap >= 0, cs.fmax(gap, before), cs.fmin(gap, -inside))
        place = place + (wanted - gap) * outward
    return place


def _of_field(field: HeightField, place: cs.SX) -> SurfaceExpression:
    """Return the ground of a height field: that of the triangle at the place, whose corners are selected from all."""
    grid = np.array(field.heights)
    rows, columns = grid.shape
    ahead, aside = place[0] - field.centre[0], place[1] - field.centre[1]
    column, row = (ahead / field.size[0] + 0.5) * (columns - 1), (aside / field.size[1] + 0.5) * (rows - 1)
    j = cs.fmin(cs.fmax(cs.floor(column), 0), columns - 2)
    i = cs.fmin(cs.fmax(cs.floor(row), 0), rows - 2)
    at_column, at_row = ([cell == k for k in range(count - 1)] for cell, count in ((j, columns), (i, rows)))
    left = [_selected(at_column, line[:-1]) for line in grid]
    right = [_selected(at_column, line[1:]) for line in grid]
    low, up, low_right, far = (
        sum(flag * value for flag, value in zip(at_row, lines, strict=True))
        for lines in (left[:-1], left[1:], right[:-1], right[1:])
    )
    u, v = column - j, row - i
    lower = u >= v  # the triangle below the diagonal from low x and y to high x and y
    inside = within(ahead, field.size[0] / 2) * within(aside, field.size[1] / 2)
    along, across = cs.if_else(lower, low_right - low, far - up), cs.if_else(lower, far - low_right, up - low)
    return SurfaceExpression(
        inside * (low + u * along + v * across),
        inside * along * (columns - 1) / field.size[0],
        inside * across * (rows - 1) / field.size[1],
    )


def _selected(flags: list[cs.SX], values: np.ndarray) -> cs.SX:
    """Return the value whose flag is 1."""
    return sum((flag * float(value) for flag, value in zip(flags, values, strict=True) if value), cs.SX(0))
