"""Footholds and swings of a gait on a terrain as CasADi expressions; see :mod:`.terrain_footsteps` for NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as cs
import numpy as np

from piaffe.ocp import Quantity

from ..foot_planes import FootSwing, foot_planes
from ..placed_ground import PlacedGround
from ..terrain import Incline
from .footsteps import cubic
from .memory import GaitMemory
from .step_expressions import StepExpressions, Swing
from .terrain_footsteps import ABOVE, EDGE, EVEN, RISE, RISER, SHARES


@dataclass(frozen=True, eq=False)
class TerrainStepExpressions(StepExpressions):
    """Footholds and swings on a terrain.

    Args:
        placed: the ground.
    """

    placed: PlacedGround

    def foothold(self, foot: int, memory: GaitMemory, touchdown: cs.SX, length: cs.SX, is_next: cs.SX) -> cs.SX:
        """Return the foothold of a stance, away from edges, with the foot's ball on the ground, (3, 1) [m]."""
        place = super().foothold(foot, memory, touchdown, length, is_next)
        radius = self.placed.radius
        return self.standing(self.placed.clear(place[:2], radius + EDGE, radius + RISER))

    def standing(self, place: cs.SX) -> cs.SX:
        """Return the place (3, 1) of a foot that stands at x and y of a place [m]."""
        return self.placed.standing(place[:2])

    def apex(self, first: cs.SX, last: cs.SX) -> cs.SX:
        """Return the height of the middle of a swing [m]; it is higher where the swing would come too near to an edge.

        As :meth:`.TerrainFootsteps._highest`. The ground of an incline sticks out nowhere.
        """
        lowest = super().apex(first, last)
        if isinstance(self.placed.terrain, Incline):
            return lowest
        radius, apex = self.placed.radius, lowest
        ball = radius / cs.fmax(cs.norm_2(last[:2] - first[:2]), 1e-9)  # its radius as a share of the way
        ends = self.placed.height(first), self.placed.height(last)
        rises = SHARES < 0.5
        lifts, _ = cubic(np.where(rises, 2 * SHARES, 2 - 2 * SHARES))
        for middle, lift, rising in zip(cubic(SHARES)[0].tolist(), lifts.tolist(), rises, strict=True):
            end = first[2] if rising else last[2]
            shares = [cs.fmin(cs.fmax(middle + side * ball, 0), 1) for side in (-1.0, 0.0, 1.0)]  # across the ball
            below = self.placed.heights_between(first, last, shares)
            sticks_out = [z - (ends[0] + share * (ends[1] - ends[0])) for z, share in zip(below, shares, strict=True)]
            needed = cs.fmax(cs.fmax(below[0], below[1]), below[2]) + radius + ABOVE
            out = cs.fmax(cs.fmax(sticks_out[0], sticks_out[1]), sticks_out[2])
            meets = cs.logic_and(out > EVEN, needed > end + ABOVE)
            apex = cs.fmax(apex, cs.if_else(meets, end + (needed - end) / lift, lowest))
        return cs.fmin(apex, lowest + RISE * float(np.min(self.reach)))

    def planes(self, swings: Sequence[Swing]) -> dict[Quantity, cs.SX]:
        """Return the planes of all feet and their heights above them, see :func:`.foot_planes`."""
        return foot_planes(
            [FootSwing(s.place, s.first, s.last, s.share, s.stands, s.lands) for s in swings], self.placed
        )
