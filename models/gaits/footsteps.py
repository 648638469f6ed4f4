"""Footsteps of a gait: which feet stand when, where they stand, and how they swing between.

A *stance* is the time that a foot stays on the ground, across phases. Axis letters: S samples, nf feet.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Foothold = Callable[[int, Array, Array], Array]

_SNAP = 1e-9  # [s]


@dataclass(frozen=True, eq=False)
class Timetable:
    """Contacts over time: phases that run once, then phases that repeat for ever.

    Args:
        once: duration [s] and contact flags (nf,) of each phase that runs once.
        cycle: the same of each phase of the cycle.
    """

    once: tuple[tuple[float, Array], ...]
    cycle: tuple[tuple[float, Array], ...]

    @property
    def period(self) -> float:
        """Length of the cycle [s]."""
        return sum(duration for duration, _ in self.cycle)

    def flags(self, phase: int) -> Array:
        """Return the contacts of a phase by its running index, (nf,)."""
        if phase < len(self.once) or not self.cycle:
            return self.once[min(phase, len(self.once) - 1)][1]
        return self.cycle[(phase - len(self.once)) % len(self.cycle)][1]

    def stances(self, foot: int, until: float) -> Array:
        """Return touchdown and lift-off of a foot's stances that begin up to a time, and of one more, (k, 2) [s].

        The first begins at −∞ if the foot stands at time 0, and is (−∞, 0) if it does not; a foot that never lifts off
        again has its lift-off at ∞.
        """
        found: list[list[float]] = [[-np.inf, 0.0]]
        standing, t, index, idle = True, 0.0, 0, 0
        while True:
            if index < len(self.once):
                duration, flags = self.once[index]
            elif self.cycle:
                duration, flags = self.cycle[(index - len(self.once)) % len(self.cycle)]
            else:
                break
            if flags[foot] and not standing:
                found.append([t, np.inf])
            if not flags[foot] and standing:
                found[-1][1] = t
                idle = 0
            standing = bool(flags[foot])
            closed = len(found) > 1 and np.isfinite(found[-1][1])
            idle += 1
            if (closed and found[-1][0] > until) or idle > len(self.once) + 2 * len(self.cycle):
                break
            t, index = t + duration, index + 1
        if standing:
            found[-1][1] = np.inf
        return np.array(found)


class Footsteps:
    """Feet over time.

    Args:
        timetable: when they stand.
        start: where they are at time 0, (nf, 3) [m].
        ground: height of a standing foot's frame [m].
        swing_height: how far a swinging foot rises above the higher of its two footholds [m].
        foothold: function of foot, touchdown and length of stances, each (k,) [s], that returns footholds (k, 2) [m];
            a foot that never lifts off again has stance length 0.
    """

    def __init__(
        self, timetable: Timetable, start: Array, ground: float, swing_height: float, foothold: Foothold
    ) -> None:
        self.timetable = timetable
        self._start, self._ground, self._swing_height, self._foothold = start, ground, swing_height, foothold
        self._until = -1.0
        self._stances: list[Array] = []
        self._holds: list[Array] = []
        self._keep: list[tuple[int, Array]] = []  # per foot, the stance whose foothold is known, and that foothold

    def held(self, t: float, feet: Array | None, foothold: Foothold) -> Footsteps:
        """Return footsteps with other footholds after time t [s], and standing feet where they are.

        Args:
            t: time [s].
            feet: where they are at that time, (nf, 3) [m]; None for where they are meant to be.
            foothold: as in the constructor.
        """
        self._extend(t)
        other = Footsteps(self.timetable, self._start, self._ground, self._swing_height, foothold)
        other._keep = []
        for foot, (stances, holds) in enumerate(zip(self._stances, self._holds, strict=True)):
            i = int(np.searchsorted(stances[:, 0], t + _SNAP, side="right")) - 1
            now = holds[i].copy()
            if feet is not None and t <= stances[i, 1]:
                now[:2] = feet[foot, :2]
            other._keep.append((i, now))
        return other

    def at(self, t: Array) -> tuple[Array, Array]:
        """Return positions, (S, nf, 3) [m], and velocities, (S, nf, 3) [m/s], of the feet at times (S,) [s]."""
        self._extend(float(np.max(t)))
        feet = [self._swing(stances, holds, t) for stances, holds in zip(self._stances, self._holds, strict=True)]
        return np.stack([p for p, _ in feet], axis=-2), np.stack([v for _, v in feet], axis=-2)

    def _extend(self, until: float) -> None:
        """Lay footholds for all stances up to a time, and twice as far at least as before."""
        if until <= self._until:
            return
        self._until = max(until, 2 * self._until, 2 * self.timetable.period)
        self._stances, self._holds = [], []
        for foot, start in enumerate(self._start):
            stances = self.timetable.stances(foot, self._until)
            touchdown, liftoff = stances[1:].T
            length = np.where(np.isfinite(liftoff), liftoff - touchdown, 0.0)
            holds = np.full((len(stances), 3), self._ground)
            holds[0] = start if np.isfinite(stances[0, 1]) and stances[0, 1] <= _SNAP else (*start[:2], self._ground)
            holds[1:, :2] = self._foothold(foot, touchdown, length)
            if self._keep:
                holds[self._keep[foot][0]] = self._keep[foot][1]
            self._stances.append(stances)
            self._holds.append(holds)

    def _swing(self, stances: Array, holds: Array, t: Array) -> tuple[Array, Array]:
        """Return a foot's place and velocity, (S, 3) each: a cubic in the plane, one up and one down in height."""
        i = np.searchsorted(stances[:, 0], t + _SNAP, side="right") - 1
        j = np.minimum(i + 1, len(stances) - 1)
        lift, land = stances[i, 1], stances[j, 0]
        swings = (t > lift) & (j > i)
        length = np.where(swings, land - lift, 1.0)
        s = np.where(swings, (t - np.where(swings, lift, 0.0)) / length, 0.0)
        place, rate = holds[i].copy(), np.zeros((len(t), 3))
        share, slope = _cubic(s)
        step = holds[j] - holds[i]
        place[:, :2] += share[:, None] * step[:, :2]
        rate[:, :2] = (slope / length)[:, None] * step[:, :2] * swings[:, None]
        rises = s < 0.5
        apex = np.maximum(holds[i, 2], holds[j, 2]) + self._swing_height
        low, high = np.where(rises, holds[i, 2], apex), np.where(rises, apex, holds[j, 2])
        share, slope = _cubic(np.where(rises, 2 * s, 2 * s - 1))
        place[:, 2] = np.where(swings, low + share * (high - low), place[:, 2])
        rate[:, 2] = slope * 2 / length * (high - low) * swings
        return place, rate


def _cubic(s: Array) -> tuple[Array, Array]:
    """Return s² (3 − 2 s) and its derivative."""
    return s**2 * (3 - 2 * s), 6 * s * (1 - s)
