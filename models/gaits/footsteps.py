"""Footsteps of a gait: the contact schedule, the footholds and the swing trajectories.

Here a *stance* is the time for which a foot stays on the ground, over any number of phases. S is the number of samples,
nf the number of feet.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import SAME_TIME

Array = NDArray[np.float64]
Foothold = Callable[[int, Array, Array], Array]

# A foothold is within this box about the place below its hip, in fractions of the leg's reach (forward, sideways), and
# its straight distance from the hip is at most this fraction of the reach.
BOX = (0.5, 0.25)
STRETCH = 0.95
_WINDOW = 20  # cycles whose stances are computed at once, late in a motion


@dataclass(frozen=True, eq=False)
class ContactSchedule:
    """Contacts over time: phases that run once, then phases that repeat without end.

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
        """Return the contact flags of a phase by its index, counted over all cycles, (nf,)."""
        if phase < len(self.once) or not self.cycle:
            return self.once[min(phase, len(self.once) - 1)][1]
        return self.cycle[(phase - len(self.once)) % len(self.cycle)][1]

    def stances(self, foot: int, until: float) -> Array:
        """Return touchdown and liftoff of a foot's stances that begin before a time, and of one more, (k, 2) [s].

        The first stance begins at −∞; it is (−∞, 0) if the foot is in the air at time 0. The liftoff of a foot that
        stays on the ground is ∞.
        """
        stances: list[list[float]] = [[-np.inf, 0.0]]
        standing, t, index, idle = True, 0.0, 0, 0
        while True:
            if index < len(self.once):
                duration, flags = self.once[index]
            elif self.cycle:
                duration, flags = self.cycle[(index - len(self.once)) % len(self.cycle)]
            else:
                break
            if flags[foot] and not standing:
                stances.append([t, np.inf])
            if not flags[foot] and standing:
                stances[-1][1] = t
                idle = 0
            standing = bool(flags[foot])
            closed = len(stances) > 1 and np.isfinite(stances[-1][1])
            idle += 1
            if (closed and stances[-1][0] > until) or idle > len(self.once) + 2 * len(self.cycle):
                break
            t, index = t + duration, index + 1
        if standing:
            stances[-1][1] = np.inf
        return np.array(stances)

    def later_stances(self, foot: int, since: float, until: float) -> tuple[int, Array]:
        """Return stances about a span of time, in a time that does not depend on when it is.

        Args:
            foot: index of the foot.
            since: the stance at this time is among those returned, and one before it [s].
            until: as for :meth:`stances`.

        Returns:
            Number of the first stance among all of the foot, and touchdown and liftoff of each, (k, 2) [s].
        """
        settled = sum(duration for duration, _ in self.once) + self.period  # from here on each cycle repeats the last
        head = self.stances(foot, settled + 3 * self.period)
        first = int(np.searchsorted(head[:, 0], settled - SAME_TIME))
        count = int(np.searchsorted(head[:, 0], settled + self.period - SAME_TIME)) - first  # stances of a cycle
        skipped = int((since - settled) // self.period) - 2 if self.period and since > settled else 0
        if not count or skipped < 1:
            return 0, self.stances(foot, until)
        cycles = int((until - settled) // self.period) + 2 - skipped
        shifts = self.period * (skipped + np.arange(cycles))
        cycle = head[first : first + count]
        return first + count * skipped, (cycle + shifts[:, None, None]).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class Known:
    """The stances in a span of time.

    Args:
        since, until: the span [s].
        firsts: per foot, the number of its first stance.
        stances, holds, apexes: of each foot, their begins and ends (k, 2) [s], footholds (k, 3) [m], and how high the
            swing goes from each to the next, (k,) [m].
    """

    since: float = np.inf
    until: float = -1.0
    firsts: tuple[int, ...] = ()
    stances: tuple[Array, ...] = ()
    holds: tuple[Array, ...] = ()
    apexes: tuple[Array, ...] = ()


class Footsteps:
    """Positions and velocities of the feet over time.

    Args:
        schedule: their contacts over time.
        start: their positions at time 0, (nf, 3) [m].
        ground: height of a standing foot's frame [m].
        swing_height: how far a swinging foot rises above the higher of its two footholds [m].
        foothold: function of foot, touchdown and duration of stances, each (k,) [s], that returns footholds (k, 2) [m];
            the duration is 0 for a foot that stays on the ground.
    """

    def __init__(
        self, schedule: ContactSchedule, start: Array, ground: float, swing_height: float, foothold: Foothold
    ) -> None:
        self.schedule = schedule
        self._start, self._ground, self._swing_height, self._foothold = start, ground, swing_height, foothold
        self._known = Known()
        self._keep: list[tuple[int, Array]] = []  # per foot, the stance whose foothold is given, and this foothold
        self._held = np.inf  # the time of these stances [s]

    def held(self, t: float, feet: Array | None, foothold: Foothold) -> Footsteps:
        """Return footsteps with other footholds after time t, in which the feet on the ground do not move.

        Args:
            t: time [s].
            feet: positions at that time, (nf, 3) [m]; None for the reference positions.
            foothold: as in the constructor.
        """
        known = self._extend(t, t)
        other = self._like(foothold)
        other._keep, other._held = [], t
        for foot, (stances, holds) in enumerate(zip(known.stances, known.holds, strict=True)):
            i = int(np.searchsorted(stances[:, 0], t + SAME_TIME, side="right")) - 1
            now = holds[i].copy()
            if feet is not None and t <= stances[i, 1] + SAME_TIME:
                now[:2] = feet[foot, :2]
                now = self._on_ground(now)
            other._keep.append((known.firsts[foot] + i, now))
        return other

    def at(self, t: Array) -> tuple[Array, Array]:
        """Return positions, (S, nf, 3) [m], and velocities, (S, nf, 3) [m/s], of the feet at times (S,) [s]."""
        known = self._extend(float(np.min(t)), float(np.max(t)))
        feet = [self._swing(*foot, t) for foot in zip(known.stances, known.holds, known.apexes, strict=True)]
        return np.stack([p for p, _ in feet], axis=-2), np.stack([v for _, v in feet], axis=-2)

    def _extend(self, since: float, until: float) -> Known:
        """Return the footholds of the stances about a span of time; they are computed unless they are known.

        Early in the motion these are all stances up to then, and at least up to twice the time of the last call. Later
        they are those of a window that moves on, so that neither time nor memory grows with the motion. An interrupt
        leaves those of before.
        """
        since, known = min(since, self._held), self._known
        if known.since <= since and until <= known.until:
            return known
        window = _WINDOW * self.schedule.period
        late = since > 2 * window > 0
        since = since - self.schedule.period if late else -np.inf
        until = max(until, min(2 * known.until, until + window), 2 * self.schedule.period)
        found: list[tuple[int, Array, Array, Array]] = []
        for foot, start in enumerate(self._start):
            first, stances = self.schedule.later_stances(foot, since, until)
            touchdown, liftoff = stances.T
            length = np.where(np.isfinite(liftoff - touchdown), liftoff - touchdown, 0.0)
            holds = np.full((len(stances), 3), self._ground)
            begins = 0
            if not first:
                begins = 1
                flies = np.isfinite(stances[0, 1]) and stances[0, 1] <= SAME_TIME
                holds[0] = start if flies else self._on_ground(np.array([*start[:2], self._ground]))
            holds[begins:, :2] = self._foothold(foot, touchdown[begins:], length[begins:])
            holds[begins:] = self._on_ground(self._clear(holds[begins:]))
            if self._keep:
                holds[self._keep[foot][0] - first] = self._keep[foot][1]
            found.append((first, stances, holds, self._highest(holds)))
        self._known = Known(since, until, *zip(*found, strict=True))
        return self._known

    def _like(self, foothold: Foothold) -> Footsteps:
        """Return new footsteps with the same numbers and other footholds."""
        return Footsteps(self.schedule, self._start, self._ground, self._swing_height, foothold)

    def _on_ground(self, holds: Array) -> Array:
        """Return where feet stand at places, (..., 3) [m]; on level ground these are the places."""
        return holds

    def _clear(self, holds: Array) -> Array:
        """Return the nearest good footholds, (..., 3) [m]; on level ground all are good."""
        return holds

    def _highest(self, holds: Array) -> Array:
        """Return the apex of the swing from each foothold to the next, (k,) [m]."""
        return np.asarray(np.maximum(holds[:, 2], np.append(holds[1:, 2], holds[-1:, 2])) + self._swing_height)

    def _swing(self, stances: Array, holds: Array, apexes: Array, t: Array) -> tuple[Array, Array]:
        """Return a foot's position and velocity, (S, 3) each: one cubic in the plane, two in height (up and down)."""
        i = np.searchsorted(stances[:, 0], t + SAME_TIME, side="right") - 1
        j = np.minimum(i + 1, len(stances) - 1)
        lift, land = stances[i, 1], stances[j, 0]
        swings = (t > lift) & (j > i)
        length = np.where(swings, land - lift, 1.0)
        s = np.where(swings, (t - np.where(swings, lift, 0.0)) / length, 0.0)
        place, rate = holds[i].copy(), np.zeros((len(t), 3))
        progress, slope = cubic(s)
        step = holds[j] - holds[i]
        place[:, :2] += progress[:, None] * step[:, :2]
        rate[:, :2] = (slope / length)[:, None] * step[:, :2] * swings[:, None]
        rises = s < 0.5
        apex = apexes[i]
        low, high = np.where(rises, holds[i, 2], apex), np.where(rises, apex, holds[j, 2])
        progress, slope = cubic(np.where(rises, 2 * s, 2 * s - 1))
        place[:, 2] = np.where(swings, low + progress * (high - low), place[:, 2])
        rate[:, 2] = slope * 2 / length * (high - low) * swings
        return place, rate


def cubic(s: Array) -> tuple[Array, Array]:
    """Return s² (3 − 2 s) and its derivative."""
    return s**2 * (3 - 2 * s), 6 * s * (1 - s)
