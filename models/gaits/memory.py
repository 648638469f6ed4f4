"""What the functions of a gait remember: the path from now on, the posture, and the places of the feet."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as cs

from .path_expression import EaseExpression, PathExpression

_FIXED = 22  # entries beside the places of the feet


@dataclass(frozen=True, eq=False)
class GaitMemory:
    """The memory of a gait as expressions; nf is the number of feet.

    Args:
        path: the path of the base in the plane.
        height: height of the base above the ground after the ramp [m].
        posture: height of the base in the world [m], roll and pitch [rad] now, (3, 1).
        rates: their rates now, (3, 1).
        upright: time until roll and pitch are zero [s].
        error: velocity that the next foothold of every foot makes up for, world axes, (2, 1) [m/s].
        lag: how far the base is behind the integral of the command, forward and left, (2, 1) [m].
        places: per foot, where it stands or has last stood, (3, 1) [m].
    """

    path: PathExpression
    height: cs.SX
    posture: cs.SX
    rates: cs.SX
    upright: cs.SX
    error: cs.SX
    lag: cs.SX
    places: list[cs.SX]

    def corrected(self, gain: float) -> GaitMemory:
        """Return the memory whose path has the velocity that makes up for the lag, at a gain [1/s]."""
        if not gain:
            return self
        more = cs.vertcat(gain * self.lag, 0)
        path = self.path
        return replace(self, path=PathExpression(path.pose, path.first + more, path.last + more, path.ramp))

    def ease(self, terrain: float) -> EaseExpression:
        """Return how the posture goes on.

        Args:
            terrain: height of the ground [m].
        """
        left = cs.vertcat(self.path.ramp, self.upright, self.upright)
        return EaseExpression(self.posture, self.rates, cs.vertcat(terrain + self.height, 0, 0), left)

    def stacked(self) -> cs.SX:
        """Return all entries, (num_memory(nf), 1)."""
        path = self.path
        return cs.vertcat(
            path.pose, path.first, path.last, path.ramp, self.height, self.posture, self.rates, self.upright,
            self.error, self.lag, *self.places,
        )  # fmt: skip

    @staticmethod
    def of(m: cs.SX) -> GaitMemory:
        """Return the memory of stacked entries."""
        path = PathExpression(m[:3], m[3:6], m[6:9], m[9])
        places = [m[at : at + 3] for at in range(_FIXED, m.numel(), 3)]
        return GaitMemory(path, m[10], m[11:14], m[14:17], m[17], m[18:20], m[20:22], places)


def memory_size(num_feet: int) -> int:
    """Return the number of entries."""
    return _FIXED + 3 * num_feet
