"""The native backend of a solve: its memory made, filled, run in a thread that can be interrupted, and read.

A start (iterate, multipliers, state of the search) is written into the memory before a solve; the same comes out after
it.
"""

from __future__ import annotations

import ctypes as ct
import warnings
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import NoCompilerError, NoCompilerWarning, Worker
from piaffe.ocp import CompiledProblem

from ...solution import Record, SearchState, Status
from ..iterate import Iterate
from ..options import Options
from ..outer import Outer
from ..run import Run
from ..warm_start import WarmStart
from . import structs as s
from .library import library_for
from .memory import Machine

Array = NDArray[np.float64]

Backend = Literal["native", "numpy"]
_POLL_S = 0.05

STATUS = (
    Status.CONVERGED, Status.ITERATION_LIMIT, Status.TIME_LIMIT, Status.LINE_SEARCH_FAILED, Status.INFEASIBLE,
    Status.NOT_FINITE, Status.INTERRUPTED,
)  # fmt: skip
"""In the order of the header's."""
_DUALS = ("relaxation", "shift", "multiplier", "penalty")


def write(machine: Machine, iterate: Iterate, outer: Outer, warm_start: WarmStart | None) -> int:
    """Lay a start into the machine; return how ``piaffe_solve`` is to be called."""
    for i, (x, u) in enumerate(zip(iterate.states, iterate.controls, strict=True)):
        machine.trial(i, "x")[:], machine.trial(i, "u")[:] = x.reshape(-1), u.reshape(-1)
    for name in _DUALS:
        machine.write_rows(name, "stage", [getattr(d, name) for d in outer.duals])
        machine.write_rows(name, "end", [getattr(d, f"end_{name}") for d in outer.duals])
    machine.c.weight, machine.c.cancel, machine.c.num_records = outer.weight, 0, 0
    return 0 if warm_start is None else _write_search(machine, warm_start)


def _write_search(machine: Machine, warm_start: WarmStart) -> int:
    c, state = machine.c, warm_start.search
    c.resume_cost, c.resume_converged = warm_start.cost, int(warm_start.converged)
    if state is None:
        c.has_last_cost, c.last_cost = c.resume_converged, c.resume_cost
        return 1
    c.resume_merit, c.rho, c.least_rho = state.merit, state.rho, state.least_rho
    c.regularization_now, c.last_step = state.regularization, state.step_size
    c.has_last_cost, c.last_cost = int(state.last_cost is not None), state.last_cost or 0.0
    c.last_equality, c.last_violation = state.last_equality, state.last_violation
    c.inner, c.unmoved, c.num_gains = state.inner, state.unmoved, len(state.gains)
    c.gains[: len(state.gains)] = state.gains
    return 2


def read_outer(machine: Machine, outer: Outer) -> None:
    """Take the machine's barrier and multipliers."""
    for name in _DUALS:
        stages, ends = machine.read_rows(name, "stage"), machine.read_rows(name, "end")
        for dual, stage, end in zip(outer.duals, stages, ends, strict=True):
            setattr(dual, name, stage.reshape(getattr(dual, name).shape))
            setattr(dual, f"end_{name}", end.reshape(getattr(dual, f"end_{name}").shape))
    outer.weight = machine.c.weight


def read_search(machine: Machine) -> SearchState:
    """Return the machine's state of the search."""
    c = machine.c
    first = max(c.num_gains - len(c.gains), 0)
    return SearchState(
        merit=float(machine.library.piaffe_merit(ct.byref(c))), rho=c.rho, least_rho=c.least_rho,
        regularization=c.regularization_now, step_size=c.last_step,
        gains=tuple(c.gains[i % len(c.gains)] for i in range(first, c.num_gains)), inner=c.inner, unmoved=c.unmoved,
        last_equality=c.last_equality, last_violation=c.last_violation,
        last_cost=c.last_cost if c.has_last_cost else None,
    )  # fmt: skip


def read_iterate(machine: Machine, read: Callable[[int, str], Array]) -> Iterate:
    """Return a copy of the iterate that ``read`` reads: the machine's accepted, trial or outside."""
    states, controls = [], []
    for i, phase in enumerate(machine.problem.phases):
        states.append(read(i, "x").reshape(phase.num_stages + 1, -1).copy())
        controls.append(read(i, "u").reshape(phase.num_stages, phase.mode.nu).copy())
    return Iterate(states, controls)


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


def native_machine(
    problem: CompiledProblem, options: Options, building: Callable[[int, int, str], None] | None = None
) -> Machine | None:
    """Return a machine that solves a problem in C; None, with one warning, where no compiler works."""
    try:
        library, _ = library_for(problem, progress=building)
    except NoCompilerError as error:
        warnings.warn(f"solving in NumPy, about ten times slower: {error}", NoCompilerWarning, stacklevel=3)
        return None
    return Machine(problem, library, options)
