"""Retiming: in flight, the clock of the motion is shifted so that the landing is due when the robot lands."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, isfinite, sqrt

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError
from piaffe.ocp import Course, Horizon

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Retiming:
    """How far landings are shifted in time.

    In a flight, the centre of mass falls freely. From its height z and speed v at the start of a plan, the time until
    it is at the height z_l, at which the declared path lands, is::

        τ = (v + √(v² + 2 g (z − z_l))) / g,    or v / g if it never gets that high

    On a terrain z_l is the height of the targets at the landing, which go with the ground where the robot steps.

    The clock of the motion is shifted by the difference of τ and the scheduled time, in whole time steps; all that
    comes later moves with it. The difference is filtered over the plans of a flight, and bounded for each flight.

    Args:
        limit: largest shift of the clock in one flight [s].
        gain: share of a new difference that the clock takes, in (0, 1].

    Raises:
        SolverError: a number is out of range.
    """

    limit: float = 0.06
    gain: float = 0.5

    def __post_init__(self) -> None:
        if not 0 < self.limit < np.inf or not 0 < self.gain <= 1:
            raise SolverError(
                f"retiming: a number is out of range - got limit {self.limit} s and gain {self.gain}, expected a limit "
                "> 0 s and a gain in (0, 1]; change it"
            )


class Clock:
    """The clock of a motion, in NumPy: the readable reference of ``clock.inc``.

    Args:
        horizon: the problem at any time.
        retiming: how far landings are shifted; None if the clock is that of the world.

    Attributes:
        shift: ticks by which the motion is later than scheduled.
    """

    def __init__(self, horizon: Horizon, retiming: Retiming | None) -> None:
        self.horizon, self.retiming = horizon, retiming
        self.reset()

    def reset(self) -> None:
        """Set the clock to the schedule."""
        self.begin(0)

    def begin(self, shift: int) -> None:
        """Let the motion be later than scheduled by so many ticks."""
        self.shift, self._flight, self._base, self._late = shift, -1, shift, 0.0

    @property
    def seconds(self) -> float:
        """The shift [s]."""
        return self.shift * self.horizon.calendar.tick

    def retime(self, x: Array, k: int, present: int | None, course: Course | None = None) -> None:
        """Shift the clock by a state in the world (nx,).

        Args:
            x: the state.
            k: its tick since the motion's start, by the clock of the world.
            present: the motion's tick of the last plan; the motion does not go back.
            course: that of the last plan; without one, no landing on a terrain is known.
        """
        horizon, calendar, own = self.horizon, self.horizon.calendar, self.retiming
        if own is None or k - self.shift < 0 or k - self.shift >= calendar.total:
            return
        place = calendar.at(k - self.shift)
        target = float(horizon.falls.heights[place.entry])
        if not isfinite(target) or (horizon.falls.follows and course is None):
            return
        if place.number != self._flight:
            self._flight, self._base, self._late = place.number, self.shift, 0.0
        table = horizon.tables.segments[0]
        store = horizon.tables.modes[int(table.mode[place.entry])]
        row = table.stage[int(table.first[place.entry]) + k - self.shift - place.start]
        p = store.rows[int(row[0])]
        fall = horizon.falls.functions[store.lowered]  # type: ignore[index]
        z, v, g = (float(each) for each in fall(x, p).full().ravel())
        if horizon.falls.follows and course is not None:
            target = float(fall(horizon.landing_state(course, place), p)[0])
        square = v * v + 2 * g * (z - target)
        rest = (v + sqrt(square)) / g if square > 0 else max(v / g, 0.0)
        end = place.start + calendar.entries[place.entry].length
        late = rest - (end - (k - self._base)) * calendar.tick
        late = min(max(late, -own.limit), own.limit)
        self._late += own.gain * (late - self._late)
        step = calendar.steps[0]
        shift = self._base + step * floor(self._late / (step * calendar.tick) + 0.5)
        earliest = place.start if present is None else max(place.start, present)
        self.shift = max(min(shift, k - earliest), k - end)
