"""The real clock as the pace of a simulation, and which deadlines were missed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from time import perf_counter, sleep
from types import TracebackType

from .real_time import garbage_kept, real_time

_SWITCH_S = 1e-4  # the interpreter changes threads after at most this time; its default is longer than a tick


@dataclass(frozen=True)
class Deadlines:
    """Deadlines of an episode against the real clock.

    Args:
        plans: number of plans that were due after the first one, which is made before the clock starts.
        missed_plans: of these, those that were not ready a latency after their state; the plan before went on.
        ticks: number of ticks.
        missed_ticks: of these, those whose torques were not ready before the next tick was due.
        latest: the longest time from when a tick was due to its torques [s].
        real_time: whether the system gave the ticks a real-time priority.
    """

    plans: int
    missed_plans: int
    ticks: int
    missed_ticks: int
    latest: float
    real_time: bool = field(default=False, compare=False)


class WallClock:
    """Paces a simulation by the real clock.

    Plant and ticks run in the calling thread, plans in a thread of their own. If a step is late, the following ones
    make up for it.

    On Linux the calling thread has a real-time priority meanwhile, if the system permits it: it does for the
    superuser, and within ``ulimit -r``. Without it, another thread may hold the processor for 4 ms. Garbage collections
    leave out what exists before.

    Args:
        now: the time [s].
        wait: waits for a duration [s].
        executor: makes the plans; by default a thread.
        priority: real-time priority of the calling thread; 0 for none.
    """

    def __init__(
        self,
        now: Callable[[], float] = perf_counter,
        wait: Callable[[float], None] = sleep,
        executor: Executor | None = None,
        priority: int = 2,
    ) -> None:
        self._now, self._wait, self._given, self._priority = now, wait, executor, priority
        self._zero: float | None = None
        self.ticks = self.missed = 0
        self.latest, self.real_time = 0.0, False

    def __enter__(self) -> WallClock:
        self._own = ExitStack()
        self._own.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(_SWITCH_S)
        self.executor: Executor = self._given or ThreadPoolExecutor(1, thread_name_prefix="planner")
        if self._given is None:
            self._own.callback(self.executor.shutdown)
        self._own.enter_context(garbage_kept())
        self.real_time = self._own.enter_context(real_time(self._priority))
        self._zero, self.ticks, self.missed, self.latest = None, 0, 0, 0.0
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._own.close()

    def reach(self, t: float) -> None:
        """Wait until a time since the start of the episode [s]; the clock starts at the first call."""
        if self._zero is None:
            self._zero = self._now() - t
        if (rest := self._zero + t - self._now()) > 0:
            self._wait(rest)

    def ticked(self, t: float, tick: float) -> None:
        """Note that the torques of a tick are ready.

        Args:
            t: when it was due [s].
            tick: time to the next tick [s].
        """
        late = 0.0 if self._zero is None else self._now() - self._zero - t
        self.ticks += 1
        self.missed += late > tick
        self.latest = max(self.latest, late)
