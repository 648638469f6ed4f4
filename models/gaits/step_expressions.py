"""Footholds and swings of a gait as CasADi expressions; see :mod:`.footsteps` and :mod:`.reference` for NumPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import SAME_TIME

from .footsteps import BOX, STRETCH
from .memory import GaitMemory
from .path_expression import turned
from .phase_row import FootRow

Array = NDArray[np.float64]


class Swing(NamedTuple):
    """A foot at a time, on the ground or between two stances.

    Args:
        place: its position, (3, 1) [m]. rate: its velocity, (3, 1) [m/s].
        first: where it stands, or has last stood, (3, 1) [m]. last: where it will, (3, 1) [m].
        share: how much of the way it has gone in the plane, 0 to 1. share_rate: the rate of this [1/s].
        stands: 1 in a phase in which it is on the ground.
        lands: 1 at the end of a swing.
    """

    place: cs.SX
    rate: cs.SX
    first: cs.SX
    last: cs.SX
    share: cs.SX
    share_rate: cs.SX
    stands: cs.SX
    lands: cs.SX


@dataclass(frozen=True, eq=False)
class StepExpressions:
    """Footholds and swings of the feet.

    Args:
        home: places of the feet of the standing robot in base axes, (nf, 3) [m].
        reach: of each leg, (nf,) [m].
        ground: height of a standing foot's frame [m].
        swing_height: how far a swinging foot rises above the higher of its two footholds [m].
        gravity: [m/s^2].
        velocity_gain: k of :class:`.GaitReference` [s]; None for √(h/g).
    """

    home: Array
    reach: Array
    ground: float
    swing_height: float
    gravity: float
    velocity_gain: float | None

    def foothold(self, foot: int, memory: GaitMemory, touchdown: cs.SX, length: cs.SX, is_next: cs.SX) -> cs.SX:
        """Return the foothold of a stance that begins after now, (3, 1) [m].

        Args:
            foot: index of the foot.
            memory: memory of the gait.
            touchdown: begin of the stance after now [s].
            length: duration of the stance [s].
            is_next: 1 for the foot's first stance after now.
        """
        home, path = cs.SX(self.home[foot, :2]), memory.path
        lever = cs.fmax(memory.height, 0) / self.gravity
        gain = cs.sqrt(lever) if self.velocity_gain is None else self.velocity_gain
        middle = touchdown + length / 2
        balance = home - lever * path.acceleration(middle)
        place = path.position(middle) + turned(path.yaw(middle), balance) + is_next * gain * memory.error
        hip, yaw = path.position(touchdown), path.yaw(touchdown)
        offset = turned(-yaw, place - hip) - home
        room = cs.sqrt(cs.fmax((STRETCH * self.reach[foot]) ** 2 - memory.height**2, 0))
        box = cs.fmin(self.reach[foot] * cs.SX(BOX), room)
        return cs.vertcat(hip + turned(yaw, home + cs.fmin(cs.fmax(offset, -box), box)), self.ground)

    def swing(self, foot: int, memory: GaitMemory, row: FootRow, phi: cs.SX, tau: cs.SX) -> Swing:
        """Return a foot's position and velocity, and the stances that it is between.

        Args:
            foot: index of the foot.
            memory: memory of the gait.
            row: numbers of the phase.
            phi: start of the phase after now [s].
            tau: time after now [s].
        """

        def place(before: cs.SX, touchdown: cs.SX, length: cs.SX) -> cs.SX:
            """Return the place of a stance: where the foot is, if it has begun."""
            ahead = self.foothold(foot, memory, phi + touchdown, length, phi + before <= SAME_TIME)
            return cs.if_else(phi + touchdown <= SAME_TIME, memory.places[foot], ahead)

        first = place(row.before, row.touchdown, row.length)
        last = place(row.touchdown, row.next_touchdown, row.next_length)
        t = tau - phi
        swings = cs.logic_and(t > row.liftoff, row.lands > 0.5)
        length = cs.if_else(swings, row.next_touchdown - row.liftoff, 1)
        s = cs.if_else(swings, cs.fmin((t - row.liftoff) / length, 1), 0)
        share, slope = cubic(s)
        step = last[:2] - first[:2]
        apex = self.apex(first, last)
        rises = s < 0.5
        low, high = cs.if_else(rises, first[2], apex), cs.if_else(rises, apex, last[2])
        lift, climb = cubic(cs.if_else(rises, 2 * s, 2 * s - 1))
        height = cs.if_else(swings, low + lift * (high - low), first[2])
        rate = cs.if_else(swings, cs.vertcat(slope * step, 2 * climb * (high - low)) / length, cs.SX.zeros(3))
        return Swing(
            cs.vertcat(first[:2] + share * step, height), rate, first, last, share,
            cs.if_else(swings, slope / length, 0), row.liftoff > SAME_TIME,
            cs.logic_and(swings, t >= row.next_touchdown - SAME_TIME),
        )  # fmt: skip

    def apex(self, first: cs.SX, last: cs.SX) -> cs.SX:
        """Return the height of the middle of the swing between two footholds (3, 1) [m]."""
        return cs.fmax(first[2], last[2]) + self.swing_height

    def standing(self, place: cs.SX) -> cs.SX:
        """Return the place (3, 1) of a foot that stands at x and y of a place (2, 1) or (3, 1) [m]."""
        return cs.vertcat(place[:2], self.ground)


def cubic(s: cs.SX) -> tuple[cs.SX, cs.SX]:
    """Return s² (3 − 2 s) and its derivative."""
    return s**2 * (3 - 2 * s), 6 * s * (1 - s)
