"""Driving the compiled solver: start, progress, interruption, and the result handed back to Python."""

from __future__ import annotations

import ctypes as ct
import threading
from collections.abc import Callable

from ..iterate import Iterate
from ..record import Record
from ..run import Run
from ..status import Status
from . import structs as s
from .machine import Machine

_STATUS = (
    Status.CONVERGED, Status.ITERATION_LIMIT, Status.TIME_LIMIT, Status.LINE_SEARCH_FAILED, Status.INFEASIBLE,
    Status.NOT_FINITE, Status.INTERRUPTED,
)  # fmt: skip
_POLL_S = 0.05
_DUALS = ("relaxation", "shift", "multiplier", "penalty")


def drive(machine: Machine, run: Run, resumed: bool, report: Callable[[Record], None] | None) -> Status:
    """Run the compiled solver from a run's iterate and duals.

    Afterwards these are the end's, as are the run's history and policy. The solver runs in a thread of its own, so that
    its log can be shown and Ctrl-C can stop it. However this function ends, the solver has stopped by then.
    """
    c, outer = machine.c, run.outer
    _write(machine, run)
    c.weight, c.cancel, c.num_records = outer.weight, 0, 0
    c.has_last_cost, c.last_cost = int(outer.last_cost is not None), outer.last_cost or 0.0
    result: list[int] = []
    worker = threading.Thread(
        target=lambda: result.append(machine.library.piaffe_solve(ct.byref(c), int(resumed))), daemon=True
    )
    interrupted = False
    try:
        worker.start()
        alive = True
        while alive:  # once more after the end, for the records of a solve shorter than a poll
            worker.join(_POLL_S)
            alive = worker.is_alive()
            _records(machine, run.history, report)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        interrupted |= _stop(machine, worker)
    _records(machine, run.history, None)
    ended = _STATUS[result[0]] if result else Status.INTERRUPTED
    accepted = bool(result) and ended is not Status.NOT_FINITE
    _read(machine, run, accepted=accepted)
    run.policy = machine.policy() if accepted else None
    return Status.INTERRUPTED if interrupted else ended


def _stop(machine: Machine, worker: threading.Thread) -> bool:
    """Stop the solver and wait for it, however often Ctrl-C is pressed meanwhile; return whether it was."""
    interrupted = False
    machine.c.cancel = 1
    while worker.is_alive():
        try:
            worker.join()
        except KeyboardInterrupt:
            interrupted = True
    return interrupted


def _write(machine: Machine, run: Run) -> None:
    """Lay a run's start and duals into the machine."""
    for i, (x, u) in enumerate(zip(run.current.iterate.states, run.current.iterate.controls, strict=True)):
        machine.trial(i, "x")[:], machine.trial(i, "u")[:] = x.reshape(-1), u.reshape(-1)
    for name in _DUALS:
        machine.write_rows(name, "stage", [getattr(d, name) for d in run.outer.duals])
        machine.write_rows(name, "end", [getattr(d, f"end_{name}") for d in run.outer.duals])


def _read(machine: Machine, run: Run, *, accepted: bool) -> None:
    """Take the machine's iterate and duals into the run."""
    for name in _DUALS:
        stages, ends = machine.read_rows(name, "stage"), machine.read_rows(name, "end")
        for dual, stage, end in zip(run.outer.duals, stages, ends, strict=True):
            setattr(dual, name, stage.reshape(getattr(dual, name).shape))
            setattr(dual, f"end_{name}", end.reshape(getattr(dual, f"end_{name}").shape))
    run.outer.weight = machine.c.weight
    states, controls = [], []
    read = machine.accepted if accepted else machine.trial
    for i, phase in enumerate(machine.problem.phases):
        states.append(read(i, "x").reshape(phase.num_stages + 1, -1).copy())
        controls.append(read(i, "u").reshape(phase.num_stages, phase.mode.nu).copy())
    run.current = run.evaluate(Iterate(states, controls))


def _records(machine: Machine, history: list[Record], report: Callable[[Record], None] | None) -> None:
    """Append the records that the solver has finished since the last call."""
    for j in range(len(history), machine.c.num_records):
        row: s.Record = machine.history[j]
        values = {name: getattr(row, name) for name in s.RECORD}
        values["iteration"] = int(values["iteration"])
        history.append(Record(**values))
        if report is not None:
            report(history[-1])
