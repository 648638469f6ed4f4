"""Driving the compiled solver: start, progress, interruption, and the result handed back to Python."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Callable

from ..record import Record
from ..run import Run
from ..status import Status
from ..warm_start import WarmStart
from . import structs as s
from .exchange import STATUS, read_iterate, read_outer, read_search, write
from .machine import Machine
from .worker import Worker

_POLL_S = 0.05


def drive(machine: Machine, run: Run, warm_start: WarmStart | None, report: Callable[[Record], None] | None) -> Status:
    """Run the compiled solver from a run's iterate and duals.

    Afterwards these are the end's, as are the run's history and policy. The solver runs in a thread of its own, so that
    its log can be shown and Ctrl-C can stop it. However this function ends, the solver has stopped by then.
    """
    c = machine.c
    resumed = write(machine, run.current.iterate, run.outer, warm_start)
    result: list[int] = []
    worker = Worker(lambda: result.append(machine.library.piaffe_solve(ct.byref(c), resumed)))
    interrupted = False
    try:
        worker.start()
        alive = True
        while alive:  # once more after the end, for the records of a solve shorter than a poll
            worker.wait(_POLL_S)
            alive = worker.runs
            _records(machine, run.history, report)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        c.cancel = 1
        interrupted |= worker.wait_out()
    _records(machine, run.history, None)
    ended = STATUS[result[0]] if result else Status.INTERRUPTED
    read_outer(machine, run.outer)
    run.take_up(read_search(machine))
    run.current = run.evaluate(read_iterate(machine, machine.accepted if result else machine.trial))
    run.outside = read_iterate(machine, machine.outside) if machine.c.blocked else None
    run.policy = machine.policy() if result and ended is not Status.NOT_FINITE else None
    return Status.INTERRUPTED if interrupted else ended


def _records(machine: Machine, history: list[Record], report: Callable[[Record], None] | None) -> None:
    """Append the records that the solver has finished since the last call."""
    for j in range(len(history), machine.c.num_records):
        row: s.Record = machine.history[j]
        values = {name: getattr(row, name) for name in s.RECORD}
        values["iteration"] = int(values["iteration"])
        history.append(Record(**values))
        if report is not None:
            report(history[-1])
