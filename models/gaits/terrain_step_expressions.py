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
from .memory import GaitMemory
from .step_expressions import StepExpressions, Swing, cubic
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
        radius, step, apex = self.placed.radius, last[:2] - first[:2], lowest
        far = cs.fmax(cs.norm_2(step), 1e-9)
        ends = self.placed.height(first), self.placed.height(last)
        for time in map(float, SHARES):
            lift, _ = cubic(2 * time if time < 0.5 else 2 - 2 * time)
            end = first[2] if time < 0.5 else last[2]
            below, sticks_out = [], []
            for side in (-1.0, 0.0, 1.0):  # across the ball
                share = cs.fmin(cs.fmax(cubic(time)[0] + side * radius / far, 0), 1)
                below.append(self.placed.height(first[:2] + share * step))
                sticks_out.append(below[-1] - (ends[0] + share * (ends[1] - ends[0])))
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
