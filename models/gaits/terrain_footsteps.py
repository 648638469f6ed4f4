"""Footsteps on a terrain: footholds away from edges, and swings that pass above what is between them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import SAME_TIME

from ..terrain import Terrain
from .footsteps import ContactSchedule, Foothold, Footsteps, cubic

Array = NDArray[np.float64]

EDGE = 0.01
"""A foothold is at least this far inside the edge of what it stands on, beside the radius of the foot [m]."""
RISER = 0.03
"""A foothold is at least this far from the side of a block, beside the radius: a swing rises before it passes [m]."""
ABOVE = 0.015
"""A swing passes at least this far above the edges between two footholds [m]."""

RISE = 0.25
"""Edges raise a swing at most by this share of the leg's reach: a foot at a riser cannot go up beside it."""
EVEN = 2e-3
"""Ground that sticks out this far from the line between two footholds has no edge [m]."""
SHARES = np.linspace(0.05, 0.95, 37)
"""Shares of a swing's time at which it is compared with the ground."""


class TerrainFootsteps(Footsteps):
    """Positions and velocities of the feet over time, on a terrain.

    Args:
        schedule, start, ground, swing_height, foothold: as for :class:`Footsteps`.
        terrain: the ground.
        radius: of the feet [m].
        reach: of the shortest leg [m].
    """

    def __init__(
        self, schedule: ContactSchedule, start: Array, ground: float, swing_height: float, foothold: Foothold,
        terrain: Terrain, radius: float, reach: float,
    ) -> None:  # fmt: skip
        super().__init__(schedule, start, ground, swing_height, foothold)
        self.terrain, self.radius, self._reach = terrain, radius, reach

    def ground(self, t: Array) -> tuple[Array, Array]:
        """Return the height of the ground of each foot, and its rate, (S, nf) each [m, m/s].

        In a swing it goes from where the foot has stood to where it will, with the foot's progress in the plane.
        """
        known = self._extend(float(np.min(t)), float(np.max(t)))
        heights, rates = np.zeros((2, len(t), len(known.stances)))
        for foot, (stances, holds) in enumerate(zip(known.stances, known.holds, strict=True)):
            i = np.searchsorted(stances[:, 0], t + SAME_TIME, side="right") - 1
            j = np.minimum(i + 1, len(stances) - 1)
            lift, land = stances[i, 1], stances[j, 0]
            swings = (t > lift) & (j > i)
            length = np.where(swings, land - lift, 1.0)
            progress, slope = cubic(np.where(swings, (t - np.where(swings, lift, 0.0)) / length, 0.0))
            levels = np.asarray(self.terrain.height(holds[:, 0], holds[:, 1]))
            heights[:, foot] = levels[i] + progress * (levels[j] - levels[i])
            rates[:, foot] = swings * slope / length * (levels[j] - levels[i])
        return heights, rates

    def _like(self, foothold: Foothold) -> Footsteps:
        return TerrainFootsteps(
            self.schedule, self._start, self._ground, self._swing_height, foothold, self.terrain, self.radius,
            self._reach,
        )  # fmt: skip

    def _on_ground(self, holds: Array) -> Array:
        """Return where feet stand at places: with their balls on the ground."""
        return self.terrain.standing(holds[..., :2], self.radius)

    def _clear(self, holds: Array) -> Array:
        """Return footholds away from edges."""
        places = self.terrain.clear(holds[..., :2], self.radius + EDGE, self.radius + RISER)
        return np.concatenate([places, holds[..., 2:]], axis=-1)

    def _highest(self, holds: Array) -> Array:
        """Return the apexes; they are higher where the swing would come too near to an edge."""
        apexes = super()._highest(holds)
        share, _ = cubic(SHARES)
        rises = SHARES < 0.5
        lift, _ = cubic(np.where(rises, 2 * SHARES, 2 - 2 * SHARES))  # 0 at both ends, 1 at the apex
        for i, (first, last) in enumerate(pairwise(holds)):
            step = last[:2] - first[:2]
            ends = np.asarray(self.terrain.height(*np.array([first, last])[:, :2].T))
            far = max(float(np.linalg.norm(step)), 1e-9)
            shares = share[:, None] + self.radius / far * np.array([-1.0, 0.0, 1.0])  # of the way, across the ball
            shares = np.clip(shares, 0.0, 1.0)
            ball = first[:2] + shares[..., None] * step
            below = self.terrain.height(ball[..., 0], ball[..., 1])
            end = np.where(rises, first[2], last[2])
            needed = np.max(below, axis=1) + self.radius + ABOVE
            sticks_out = np.max(below - (ends[0] + shares * (ends[1] - ends[0])), axis=1) > EVEN
            meets = sticks_out & (needed > end + ABOVE)  # higher ground than at this end of the swing
            if meets.any():
                wanted = float(np.max((end + (needed - end) / lift)[meets]))
                apexes[i] = max(apexes[i], min(wanted, apexes[i] + RISE * self._reach))
        return apexes
