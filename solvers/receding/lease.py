"""A receding horizon and a low level that belong to a loop while it runs."""

from __future__ import annotations

import os
import weakref

import numpy as np

from piaffe.errors import SolverError

from ..tracking import LowLevel
from .loop_memory import PLACES, LoopMemory

_NO_THREADS = 32  # of loop.h


class Lease:
    """Lends a receding horizon and a low level to a loop; both are as before at its end, with the last plans.

    The plans go on from the last one of the receding horizon, if there is one. A lease that nothing refers to ends, and
    so does one that is left at the end of the program.

    Args:
        memory: of the loop.
        low: the low level.
        period: time between plans [s].
        thread: whether plans are made in a thread of their own.

    Raises:
        SolverError: there is no thread.
    """

    def __init__(self, memory: LoopMemory, low: LowLevel, period: float, *, thread: bool) -> None:
        planner, last = memory.planner, memory.planner.plan
        begins = -np.inf if last is None else last.measured_at + period
        memory.library.loop_init(memory.address, int(last is not None), begins)
        if last is not None and last is not low.plan and planner.goes_on:
            memory.wait_with(last)
        if thread and (code := memory.library.loop_start(memory.address)):
            why = "this platform has no POSIX threads" if code == _NO_THREADS else "the system refuses one"
            raise SolverError(
                f"loop: no thread for plans - got {why}, expected a thread; use running(low, thread=False), which "
                "makes plans within the tick"
            )
        memory.told[:] = planner.told
        planner.told = memory.told
        memory.low.tick_through(memory.library.loop_tick, memory.address, memory)
        self._process = os.getpid()
        self._end = weakref.finalize(self, _end, memory, low, self._process)

    @property
    def is_on(self) -> bool:
        """Whether it has not ended."""
        return self._end.alive

    @property
    def is_here(self) -> bool:
        """Whether it began in this process, and not in one from which this is forked."""
        return self._process == os.getpid()

    def end(self) -> None:
        """End it, after the plan that is being made; do nothing if it has ended."""
        self._end()


def _end(memory: LoopMemory, low: LowLevel, process: int) -> None:
    """Stop a loop, and give back what it has."""
    planner, c = memory.planner, memory.c
    forked = process != os.getpid()
    if forked:
        c.thread = None  # there is no such thread in this process
    memory.library.loop_stop(memory.address)
    memory.low.tick_by_itself()
    planner.commands[:] = memory.told
    planner.told = planner.commands
    acting = c.plans.acting
    followed = planner.copy(memory.places[acting]) if c.taken else None
    if forked:
        planner.reset()  # its memory may be half written
    elif c.newest == acting and followed is not None:
        planner.go_on_from(followed)
    elif c.newest < PLACES:
        planner.go_on_from(planner.copy(memory.places[c.newest]))
    if followed is not None:
        low.follow(followed)
