"""The planes of the feet of a plan as expressions; see :mod:`.footing` for the same in NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as cs

from piaffe.ocp import Quantity

from .placed_ground import PlacedGround, PlaneExpression
from .quantities import feet


class FootSwing(NamedTuple):
    """A foot at a time, on the ground or between two stances.

    Args:
        place: its position, (3, 1) [m].
        first: where it stands, or has last stood; x and y count, (2, 1) or (3, 1) [m]. last: where it will.
        share: how much of the way it has gone in the plane, 0 to 1.
        stands: 1 in a phase in which it is on the ground.
        lands: 1 at the end of a swing.
    """

    place: cs.SX
    first: cs.SX
    last: cs.SX
    share: cs.SX
    stands: cs.SX
    lands: cs.SX


def foot_planes(swings: Sequence[FootSwing], ground: PlacedGround) -> dict[Quantity, cs.SX]:
    """Return ``feet.surfaces`` and ``feet.normals`` of all feet, and ``feet.height`` above the ground where they stand.

    Args:
        swings: the feet.
        ground: the ground in the frame of the plan.
    """
    stood, over, beside, heights = [], [], [], []
    for swing in swings:
        plane = plane_between(swing, ground)
        above, aside = ground.about(swing.place)
        lands, stands = swing.lands > 0.5, swing.stands > 0.5
        above = _chosen(cs.logic_or(lands, stands), plane, above)
        aside = _chosen(lands, ground.within(swing.place), aside)
        aside = _chosen(stands, ground.none_beside(swing.place), aside)
        stood.append(plane)
        over.append(above)
        beside.append(aside)
        heights.append(cs.dot(plane[1], swing.place - plane[0]) - ground.radius)
    every = stood + over + beside
    return {
        feet.height: cs.vertcat(*heights),
        feet.surfaces: cs.vertcat(*(point for point, _ in every)),
        feet.normals: cs.vertcat(*(normal for _, normal in every)),
    }


def plane_between(swing: FootSwing, ground: PlacedGround) -> PlaneExpression:
    """Return the plane of a foot where it stands, in the air that between those of its stances."""
    (point, normal), (end, other), s = ground.surface(swing.first), ground.surface(swing.last), swing.share
    mixed = (1 - s) * normal + s * other
    still = s <= 0
    return (
        cs.if_else(still, point, (1 - s) * point + s * end),
        cs.if_else(still, normal, mixed / cs.norm_2(mixed)),
    )


def _chosen(condition: cs.SX, one: PlaneExpression, other: PlaneExpression) -> PlaneExpression:
    return cs.if_else(condition, one[0], other[0]), cs.if_else(condition, one[1], other[1])
