"""Several motions in Python: the readable reference of ``template/motions.inc``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import ceil, floor, isinf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import SAME_TIME, Horizon, LoweredMode

from .changes import Changes
from .numpy_tick import NumpyTick
from .plan import Plan, followed_modes
from .predict import predicted

Array = NDArray[np.float64]


class Change(NamedTuple):
    """Where the active motion gives way: the next motion, its first phase, and a tick of the active one's clock."""

    motion: int
    entry: int
    at: int


class NumpyMotions:
    """Plans of several motions in Python and NumPy.

    Args:
        names: of the motions.
        ticks: their planners.
        changes: where one motion gives way to another.
        after: per motion, the one that follows its end; -1 for the last one without an end.
        start: the first motion. home: the one that counts as the last one without an end before the first plan.
        preparations: plans that are made ahead of a change, at least.
        period: between plans [s]. latency: of plans [s].
        iterations: of a plan. first_iterations: of the first plan.
    """

    def __init__(
        self, names: Sequence[str], ticks: Sequence[NumpyTick], changes: Changes, after: Sequence[int], *, start: int,
        home: int, preparations: int, period: float, latency: float, iterations: int, first_iterations: int,
    ) -> None:  # fmt: skip
        self._names, self._ticks, self._entries, self._after = tuple(names), ticks, changes.entries, after
        self._start, self._first_home, self._preparations = start, home, preparations
        self._period, self._latency = period, latency
        self._iterations, self._first_iterations = iterations, first_iterations
        self.modes: tuple[LoweredMode, ...] = tuple(
            dict.fromkeys(mode for each in ticks for mode in followed_modes(each.horizon))
        )
        self.reset()

    def reset(self) -> None:
        """Forget all plans and the request."""
        for each in self._ticks:
            each.reset()
        self.active, self.request, self._next, self._entry, self._made = self._start, -1, -1, -1, 0
        self._home, self._left, self._until = self._first_home, -1, 0.0

    def ask_for(self, motion: int) -> None:
        """Ask for a motion, from the next plan on."""
        self.request = -1 if motion == self.active else motion

    def __call__(self, x: Array, t: float, commands: Mapping[str, float]) -> Plan:
        """Return a plan from a state in the world (nx,) that was measured at time t [s]."""
        tick, change, plan = self._ticks[self.active], None, None
        b = self._begin(tick.horizon, t + self._latency)
        if tick.began:
            change = self._change(tick, b)
        if change is None:
            self._next, self._made = -1, 0
        ahead = 0 if change is None else self._plans_until(tick, b, change.at)
        if change is not None and ahead < 1:
            plan = self._change_to(tick, change, x, t, commands)
        if plan is None:
            plan = self._active(x, t, commands)
            if change is not None and 1 <= ahead <= self._preparations and tick.plan is not None:
                self._prepare(tick, change, t, commands)
        request = "" if self.request < 0 else self._names[self.request]
        return replace(plan, motion=self._names[self.active], request=request, every_mode=self.modes)

    # ---- where the active motion gives way

    def _change(self, tick: NumpyTick, b: int) -> Change | None:
        """Return where the active motion, whose next plan begins at tick b, gives way; None if it goes on."""
        calendar, shift, entries = tick.horizon.calendar, tick.clock.shift, self._entries[self.active]
        k, count = b - shift, len(calendar.entries)
        if not isinf(calendar.total):  # a motion with an end is finished first
            asked = self.request >= 0 and entries[count, self.request] >= 0
            after = self._after[self.active]
            motion = self.request if asked else after if after >= 0 else self._home
            at = int(calendar.total) + shift if k < calendar.total else b
            if self._made > 0 and self._plans_until(tick, b, at) < self._preparations:
                motion = self._next  # too late for another one
            entry = int(entries[count, motion])
            return Change(motion, entry, at) if entry >= 0 else None
        if self.request < 0:
            return None
        place = calendar.at(max(k, 0))
        if place.start < k:
            place = calendar.next(place)
        for _ in range(count):
            entry = int(entries[place.entry, self.request])
            at = place.start + shift
            kept = self._made if (self._next, self._entry) == (self.request, entry) else 0
            if entry >= 0 and kept + self._plans_until(tick, b, at) >= self._preparations:
                return Change(self.request, entry, at)
            place = calendar.next(place)
        return None

    def _plans_until(self, tick: NumpyTick, b: int, at: int) -> int:
        """Return the number of plans that begin before a tick, from the one that begins at tick b."""
        return floor(((at - b) * tick.horizon.calendar.tick + SAME_TIME) / self._period)

    # ---- plans

    def _active(self, x: Array, t: float, commands: Mapping[str, float]) -> Plan:
        """Return a plan of the active motion; until its first plan acts, the robot follows the motion before."""
        tick = self._ticks[self.active]
        start = self._begin(tick.horizon, t + self._latency) * tick.horizon.calendar.tick
        if self._left >= 0 and t < self._until - SAME_TIME:
            then = self._ticks[self._left].later(x, t, self._until)
            state = tick.predicted(x if then is None else then, self._until, start)
        else:
            self._left = -1
            state = tick.predicted(x, t, start)
        iterations = self._iterations if tick.began else self._first_iterations
        return tick(state, start, t, iterations, self._commands(tick, commands))

    def _prepare(self, tick: NumpyTick, change: Change, t: float, commands: Mapping[str, float]) -> None:
        """Make a plan of the motion that is next, ahead of its beginning, as the first guess of a later one."""
        self._choose(change)
        begin = self._set_clock(change.at * tick.horizon.calendar.tick)
        plan = tick.plan
        assert plan is not None  # it has just been made
        until = begin * self._ticks[change.motion].horizon.calendar.tick
        state = plan.world(predicted(plan, plan.parts[0].states[0], plan.start, until))
        if np.isfinite(state).all():
            self._made = 0 if self._first(state, until, t, commands) is None else self._made + 1

    def _change_to(
        self, tick: NumpyTick, change: Change, x: Array, t: float, commands: Mapping[str, float]
    ) -> Plan | None:
        """Return the plan with which the next motion takes over; None if it is not finite."""
        self._choose(change)
        begin = self._set_clock(change.at * tick.horizon.calendar.tick)
        until = begin * self._ticks[change.motion].horizon.calendar.tick
        state = tick.later(x, t, until)
        plan = self._first(x if state is None else state, until, t, commands)
        if plan is not None:
            self._left, self._until, self.active = self.active, until, change.motion
            self.request = -1 if self.request == self.active else self.request
            if isinf(self._ticks[self.active].horizon.calendar.total):
                self._home = self.active
        self._next, self._made = -1, 0
        return plan

    def _choose(self, change: Change) -> None:
        """Note what is next; plans that were made ahead of another change do not count."""
        if (change.motion, change.entry) != (self._next, self._entry):
            self._made = 0
        self._next, self._entry = change.motion, change.entry

    def _set_clock(self, time: float) -> int:
        """Let the phase of the next motion begin at a time [s], and return the tick at which its plan begins."""
        tick = self._ticks[self._next]
        calendar, begin = tick.horizon.calendar, self._begin(tick.horizon, time)
        k = -(-calendar.entries[self._entry].start // calendar.steps[0]) * calendar.steps[0]
        if self._made == 0 or tick.course is None or tick.course.tick != k:
            tick.plan = tick.course = None
        tick.began = True  # as many iterations as any later plan
        tick.clock.begin(begin - k)
        return begin

    def _first(self, state: Array, start: float, t: float, commands: Mapping[str, float]) -> Plan | None:
        """Return the first plan of the motion that is next; None if it is not finite."""
        tick = self._ticks[self._next]
        plan = tick(state, start, t, self._iterations, self._commands(tick, commands), anew=True)
        return None if tick.plan is None else plan

    @staticmethod
    def _begin(horizon: Horizon, time: float) -> int:
        """Return the tick of the world's clock at which a plan that is ready at a time [s] begins."""
        return ceil((time - SAME_TIME) / horizon.dt) * horizon.calendar.steps[0]

    @staticmethod
    def _commands(tick: NumpyTick, commands: Mapping[str, float]) -> dict[str, float]:
        return {name: value for name, value in commands.items() if name in tick.horizon.commands}
