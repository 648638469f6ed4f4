"""What lets a thread of Python meet deadlines: a real-time priority, and garbage collections that are short."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def real_time(priority: int) -> Iterator[bool]:
    """Give the calling thread a real-time priority, and say whether the system has done so.

    Threads and processes that it starts do not inherit it. A machine with one processor is left alone, because a thread
    that falls behind would stop everything else.

    Args:
        priority: 1 to 99; 0 for none.
    """
    if priority == 0 or not hasattr(os, "sched_setscheduler") or (os.cpu_count() or 1) < 2:
        yield False
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    if before[0] & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR):
        yield True
        return
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except PermissionError:
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, *before)


@contextmanager
def garbage_kept() -> Iterator[None]:
    """Leave what exists now out of garbage collections: one of all objects takes longer than a tick."""
    if gc.get_freeze_count():  # the caller does this already
        yield
        return
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
