"""Run a solve in C: write its start into the solver's memory, run the solver in a thread, and read the result.

The start is an iterate, multipliers, and the state of the search. The result has the same parts.
"""

from __future__ import annotations

import ctypes as ct
import warnings
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import NoCompilerError, NoCompilerWarning, UnsupportedOperationError, Worker
from piaffe.ocp import CompiledProblem

from ...solution import Record, SearchState, Status
from ..iterate import Iterate
from ..options import Options
from ..outer import Outer
from ..run import Run
from ..scale import natural_time, scale_of, unit_cost
from ..warm_start import WarmStart
from . import structs as s
from .library import library_for
from .memory import SolverMemory
from .unsupported import refused

Array = NDArray[np.float64]

Backend = Literal["native", "numpy"]
_POLL_S = 0.05

STATUS = (
    Status.CONVERGED, Status.ITERATION_LIMIT, Status.TIME_LIMIT, Status.LINE_SEARCH_FAILED, Status.INFEASIBLE,
    Status.NOT_FINITE, Status.INTERRUPTED, Status.STATIONARY,
)  # fmt: skip
"""The statuses in the order of the enumeration in ``piaffe.h``."""
_DUALS = ("relaxation", "shift", "multiplier", "penalty")


def write(memory: SolverMemory, iterate: Iterate, outer: Outer, warm_start: WarmStart | None) -> int:
    """Write a start into the memory; return the argument ``resumed`` of ``piaffe_solve``."""
    for i, (x, u) in enumerate(zip(iterate.states, iterate.controls, strict=True)):
        memory.trial(i, "x")[:], memory.trial(i, "u")[:] = x.reshape(-1), u.reshape(-1)
    for name in _DUALS:
        memory.write_rows(name, "stage", [getattr(d, name) for d in outer.duals])
        memory.write_rows(name, "end", [getattr(d, f"end_{name}") for d in outer.duals])
    memory.c.weight, memory.c.cancel, memory.c.num_records = outer.weight, 0, 0
    return 0 if warm_start is None else _write_search(memory, warm_start)


def _write_search(memory: SolverMemory, warm_start: WarmStart) -> int:
    c, state = memory.c, warm_start.search
    c.resume_cost, c.resume_converged = warm_start.cost, int(warm_start.converged)
    if state is None:
        c.has_last_cost, c.last_cost = c.resume_converged, c.resume_cost
        return 1
    c.resume_merit, c.rho, c.least_rho = state.merit, state.rho, state.least_rho
    c.regularization_now, c.last_step = state.regularization, state.step_size
    c.has_last_cost, c.last_cost = int(state.last_cost is not None), state.last_cost or 0.0
    c.last_equality, c.last_violation = state.last_equality, state.last_violation
    c.last_inequality, c.stiffness = state.last_inequality, state.stiffness or c.options.stiffness
    gains = state.gains[-len(c.gains) :]
    c.inner, c.unmoved, c.num_gains = state.inner, state.unmoved, len(gains)
    c.gains[: len(gains)] = gains
    return 2


def read_outer(memory: SolverMemory, outer: Outer) -> None:
    """Copy barrier and multipliers from the memory."""
    for name in _DUALS:
        stages, ends = memory.read_rows(name, "stage"), memory.read_rows(name, "end")
        for dual, stage, end in zip(outer.duals, stages, ends, strict=True):
            setattr(dual, name, stage.reshape(getattr(dual, name).shape))
            setattr(dual, f"end_{name}", end.reshape(getattr(dual, f"end_{name}").shape))
    outer.weight = memory.c.weight


def read_search(memory: SolverMemory) -> SearchState:
    """Return the state of the search from the memory."""
    c = memory.c
    first = max(c.num_gains - len(c.gains), 0)
    return SearchState(
        merit=float(memory.library.piaffe_merit(ct.byref(c))), rho=c.rho, least_rho=c.least_rho,
        regularization=c.regularization_now, step_size=c.last_step,
        gains=tuple(c.gains[i % len(c.gains)] for i in range(first, c.num_gains)), inner=c.inner, unmoved=c.unmoved,
        last_equality=c.last_equality, last_violation=c.last_violation,
        last_cost=c.last_cost if c.has_last_cost else None, last_inequality=c.last_inequality, stiffness=c.stiffness,
    )  # fmt: skip


def read_iterate(memory: SolverMemory, read: Callable[[int, str], Array]) -> Iterate:
    """Return a copy of an iterate in the memory; ``read`` is its method ``accepted``, ``trial`` or ``outside``."""
    states, controls = [], []
    for i, phase in enumerate(memory.problem.phases):
        states.append(read(i, "x").reshape(phase.num_stages + 1, -1).copy())
        controls.append(read(i, "u").reshape(phase.num_stages, phase.mode.nu).copy())
    return Iterate(states, controls)


def native_scale(memory: SolverMemory) -> float:
    """Return the scale of the cost of the problem in the memory, as :func:`piaffe.solvers.ilqr.scale.cost_scale`."""
    unit = unit_cost(memory.problem)
    if unit <= 0:
        return 1.0
    for i, phase in enumerate(memory.problem.phases):
        memory.trial(i, "x")[:], memory.trial(i, "u")[:] = phase.guess_states.ravel(), phase.guess_controls.ravel()
    time = natural_time(memory.problem)
    return scale_of(float(memory.library.piaffe_predicted(ct.byref(memory.c), unit, time)), unit)


def run_native(
    memory: SolverMemory, run: Run, warm_start: WarmStart | None, report: Callable[[Record], None] | None
) -> Status:
    """Run the compiled solver from the iterate and the duals of a run, and write the result into the run.

    The result is iterate, duals, history and policy. The solver runs in a thread of its own, so that records are
    reported during the solve and Ctrl-C stops it. When this function returns or raises, the solver has stopped.
    """
    c = memory.c
    memory.set_shooting(run.shooting)
    resumed = write(memory, run.current.iterate, run.outer, warm_start)
    result: list[int] = []
    worker = Worker(lambda: result.append(memory.library.piaffe_solve(ct.byref(c), resumed)))
    interrupted = False
    try:
        worker.start()
        alive = True
        while alive:  # once more after the end, for the records since the last poll
            worker.wait(_POLL_S)
            alive = worker.runs
            _records(memory, run.history, report)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        c.cancel = 1
        interrupted |= worker.wait_out()
    _records(memory, run.history, None)
    ended = STATUS[result[0]] if result else Status.INTERRUPTED
    read_outer(memory, run.outer)
    run.restore(read_search(memory))
    run.current = run.evaluate(read_iterate(memory, memory.accepted if result else memory.trial))
    run.outside = read_iterate(memory, memory.outside) if memory.c.blocked else None
    run.policy = memory.policy() if result and ended is not Status.NOT_FINITE else None
    return Status.INTERRUPTED if interrupted else ended


def _records(memory: SolverMemory, history: list[Record], report: Callable[[Record], None] | None) -> None:
    """Append the records of the iterations since the last call, and report them."""
    for j in range(len(history), memory.c.num_records):
        row: s.RecordStruct = memory.history[j]
        values = {name: getattr(row, name) for name in s.RECORD}
        values["iteration"] = int(values["iteration"])
        history.append(Record(**values))
        if report is not None:
            report(history[-1])


def native_memory(
    problem: CompiledProblem, options: Options, building: Callable[[int, int, str], None] | None = None
) -> SolverMemory | None:
    """Return the memory of the compiled solver for a problem; None, with a warning, if no compiler works.

    Raises:
        ProblemError: an expression of a term or of a model has no form in C.
    """
    try:
        library, _ = library_for(problem, progress=building)
    except UnsupportedOperationError as error:
        raise refused(problem, error) from error
    except NoCompilerError as error:
        warnings.warn(f"solving in NumPy, about ten times slower: {error}", NoCompilerWarning, stacklevel=3)
        return None
    return SolverMemory(problem, library, options)
