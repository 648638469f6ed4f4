"""Driving the compiled solver: start, progress, interruption, and the result handed back to Python."""

from __future__ import annotations

import ctypes as ct
import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..iterate import Iterate
from ..record import Record
from ..run import Run
from ..solution import Solution
from ..status import Status
from . import structs as s
from .machine import Machine

Array = NDArray[np.float64]

_STATUS = (
    Status.CONVERGED, Status.ITERATION_LIMIT, Status.TIME_LIMIT, Status.LINE_SEARCH_FAILED, Status.INFEASIBLE,
    Status.NOT_FINITE, Status.INTERRUPTED,
)  # fmt: skip
_POLL_S = 0.05
_DUALS = ("relaxation", "shift", "multiplier", "penalty")


def drive(machine: Machine, run: Run, warm_start: Solution | None, report: Callable[[Record], None] | None) -> Status:
    """Run the compiled solver from a run's iterate and duals, which are the end's afterwards, as is its history.

    The solver runs in a thread of its own, so that its log can be shown and Ctrl-C can stop it. However this function
    ends, the solver has stopped by then.
    """
    c = machine.c
    _write(machine, run)
    c.cancel = c.num_records = 0
    resumed = load_search(machine, warm_start)
    result: list[int] = []
    worker = threading.Thread(
        target=lambda: result.append(machine.library.piaffe_solve(ct.byref(c), resumed)), daemon=True
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
    _read(machine, run, accepted=bool(result))
    run.outside = iterate_of(machine, machine.outside) if machine.c.blocked else None
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
    take_search(machine, run)
    run.current = run.evaluate(iterate_of(machine, machine.accepted if accepted else machine.trial))


def iterate_of(machine: Machine, read: Callable[[int, str], Array]) -> Iterate:
    """Return a copy of the iterate that ``read`` reads."""
    states, controls = [], []
    for i, phase in enumerate(machine.problem.phases):
        states.append(read(i, "x").reshape(phase.num_stages + 1, -1).copy())
        controls.append(read(i, "u").reshape(phase.num_stages, phase.mode.nu).copy())
    return Iterate(states, controls)


def load_search(machine: Machine, warm_start: Solution | None) -> int:
    """Write what a warm start knows of barrier and search; return how ``piaffe_solve`` is to be called."""
    c = machine.c
    if warm_start is None:
        return 0
    c.weight, c.resume_cost, c.resume_converged = warm_start.barrier_weight, warm_start.cost, int(warm_start.converged)
    state = warm_start.search
    if state is None:
        c.has_last_cost, c.last_cost = c.resume_converged, c.resume_cost
        return 1
    c.has_last_cost, c.last_cost = int(state.last_cost is not None), state.last_cost or 0.0
    c.resume_merit, c.rho, c.least_rho, c.regularization_now = (
        state.merit,
        state.rho,
        state.least_rho,
        state.regularization,
    )
    c.last_step, c.inner, c.unmoved, c.num_gains = state.step_size, state.inner, state.unmoved, len(state.gains)
    c.last_equality, c.last_violation = state.last_equality, state.last_violation
    c.gains[: len(state.gains)] = state.gains
    return 2


def take_search(machine: Machine, run: Run) -> None:
    """Take the machine's state of the search into the run."""
    c, outer = machine.c, run.outer
    run.rho, run.least_rho, run.regularization = c.rho, c.least_rho, c.regularization_now
    run.step_size, run.inner, outer.unmoved = c.last_step, c.inner, c.unmoved
    first = max(c.num_gains - len(c.gains), 0)
    run.gains = [c.gains[i % len(c.gains)] for i in range(first, c.num_gains)]
    outer.last_cost = c.last_cost if c.has_last_cost else None
    outer.last_equality, outer.last_violation = c.last_equality, c.last_violation


def _records(machine: Machine, history: list[Record], report: Callable[[Record], None] | None) -> None:
    """Append the records that the solver has finished since the last call."""
    for j in range(len(history), machine.c.num_records):
        row: s.Record = machine.history[j]
        values = {name: getattr(row, name) for name in s.RECORD}
        values["iteration"] = int(values["iteration"])
        history.append(Record(**values))
        if report is not None:
            report(history[-1])
