"""Batches: many instances of one problem (other initial states, masses, friction), solved in parallel."""

from __future__ import annotations

import ctypes as ct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.codegen import Worker, available_cores
from piaffe.errors import ProblemError, ShapeError, SolverError
from piaffe.ocp import (
    CompiledProblem,
    ParameterKey,
    Parameters,
    Problem,
    check_numbers,
    compile_problem,
    early_warnings,
    find_warnings,
    initial_state,
    instance,
    numbers_of,
    require_derivatives,
)

from ..ilqr import (
    STATUS,
    Backend,
    Options,
    Outer,
    ProblemFunctions,
    Run,
    SolverMemory,
    WarmStart,
    assemble,
    cost_scale,
    first_iterate,
    issue,
    iterate_from,
    native_memory,
    native_scale,
    read_iterate,
    read_outer,
    read_search,
    scaled,
    with_cause,
    write,
)
from ..solution import Solution, Status
from .solution import BatchRecorder, BatchSolution

Array = NDArray[np.float64]
Starts = Solution | BatchSolution | Sequence[Solution | None] | None
_POLL_S = 0.05


def solve_batch(
    problem: Problem | CompiledProblem,
    initial_states: ArrayLike | None = None,
    parameters: Mapping[str, ArrayLike] | None = None,
    options: Options | None = None,
    *,
    backend: Backend = "native",
    threads: int | None = None,
    warm_start: Starts = None,
    gains: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> BatchSolution:
    """Solve many instances of one problem.

    States and gains of an instance are equal to the last bit to those of
    ``MSiLQR(compiled.with_parameters(its parameters).with_start(its start), options).solve(its warm start)``, for any
    number of threads. Ctrl-C stops the batch; the result then has the instances up to there.

    Args:
        problem: the declaration, or the compiled problem.
        initial_states: (batch, nx); None for the problem's own in every instance. Targets stay those of the problem.
        parameters: name → values (batch, size), or (batch,) for single numbers; the names are those of
            ``compiled.parameters``.
        options: options of every solve.
        backend: as in :class:`MSiLQR`; ``"numpy"`` solves one instance after the other.
        threads: number of instances that are solved at the same time; by default the number of cores.
        warm_start: one solution for all, a batch of the same size, or a sequence with one (or None) per instance.
        gains: whether the result contains the policy's feedforward and feedback.
        progress: called in the calling thread with the number of finished instances and of all instances.

    Raises:
        UnknownNameError: a parameter is not among those of the problem.
        ShapeError: shapes do not fit each other or the problem.
        ProblemError: a value is not finite, or bounds exclude each other.
        SolverError: a warm start does not fit, or threads is not positive.
    """
    began = time.perf_counter()
    if not isinstance(problem, Problem | CompiledProblem):
        raise SolverError(
            f"solve_batch: not a problem - got {type(problem).__name__}, expected an ocp.Problem; declare one"
        )
    if backend not in ("native", "numpy"):
        raise SolverError(
            f"solve_batch: backend is unknown - got {backend!r}, expected 'native' or 'numpy'; choose one"
        )
    if threads is not None and not (isinstance(threads, int) and threads > 0):
        raise SolverError(
            f"solve_batch: threads is out of range - got {threads!r}, expected a positive number; give one"
        )
    require_derivatives(problem, "solve_batch")
    if isinstance(problem, Problem):
        issue(early_warnings(problem))
        compiled = compile_problem(problem)
        issue(find_warnings(compiled))
    else:
        compiled = problem
    check_numbers(compiled)
    batch = _Batch(compiled, initial_states, parameters or {}, warm_start, options or Options(), gains)
    memory = native_memory(compiled, batch.options) if backend == "native" else None
    if memory is None:
        used = 1
        batch.solve_in_numpy(progress)
    else:
        used = min(threads or available_cores(), batch.size)
        batch.solve_in_c(memory, used, progress)
    return batch.recorder.solution(time.perf_counter() - began, used)


class _Batch:
    """The instances of a batch, all checked before the first solve, and their results."""

    def __init__(
        self,
        compiled: CompiledProblem,
        initial_states: ArrayLike | None,
        parameters: Mapping[str, ArrayLike],
        warm_start: Starts,
        options: Options,
        gains: bool,
    ) -> None:
        self.compiled, self.options = compiled, options
        known = compiled.parameters
        keys = {name: known.key(name, "solve_batch") for name in parameters}
        tables = {name: _rows(known, name, value) for name, value in parameters.items()}
        sizes = {f"parameter '{name}'": len(table) for name, table in tables.items()}
        starts: Array | None = None
        if initial_states is not None:
            starts = numbers_of(initial_states, "solve_batch", "initial states")
            nx = compiled.initial.size
            if starts.ndim != 2 or starts.shape[1] != nx:
                raise ShapeError(
                    f"solve_batch: initial states have the wrong shape - got {starts.shape}, expected (batch, {nx}); "
                    "give one row per instance"
                )
            sizes["initial states"] = len(starts)
        if warm_start is not None and not isinstance(warm_start, Solution):
            sizes["warm start"] = len(warm_start)
        if len(set(sizes.values())) != 1 or 0 in sizes.values():
            raise ShapeError(
                f"solve_batch: number of instances is unclear - got {sizes or 'nothing that varies'}, expected the "
                "same positive number everywhere; give the same number of rows for each"
            )
        self.size = next(iter(sizes.values()))
        self.values: list[dict[ParameterKey, Array]] = []
        self.starts, self.warm = [], []
        shared = WarmStart.of(warm_start) if isinstance(warm_start, Solution) else None
        bounded = any(key.is_bound for key in keys.values())
        model = compiled.phases[0].mode.model
        for i in range(self.size):
            where = f"solve_batch, instance {i}"
            self.values.append({keys[name]: known.check(name, table[i], where) for name, table in tables.items()})
            self.starts.append(compiled.initial if starts is None else initial_state(model, starts[i], where))
            self.warm.append(shared or _warm_start(warm_start, i))
            try:
                if i == 0 or not isinstance(warm_start, Solution):
                    first_iterate(compiled, self.warm[i])
                if bounded:
                    self.instance(i)  # raises if bounds exclude each other
            except (ProblemError, SolverError) as error:
                raise type(error)(f"{where}: {error}") from error
        self.recorder = BatchRecorder(compiled, self.size, gains)

    def instance(self, i: int) -> CompiledProblem:
        """Return instance i."""
        return instance(self.compiled, self.values[i], self.starts[i])

    # ---- in NumPy, one after the other

    def solve_in_numpy(self, progress: Callable[[int, int], None] | None) -> None:
        """Solve every instance; Ctrl-C stops the batch, and the iterate of the running instance is kept."""
        functions = ProblemFunctions(self.compiled)
        for i in range(self.size):
            try:
                interrupted = self._solve_one_in_numpy(functions, i)
                if progress is not None:
                    progress(i + 1, self.size)
            except KeyboardInterrupt:
                return
            if interrupted:
                return

    def _solve_one_in_numpy(self, functions: ProblemFunctions, i: int) -> bool:
        began, warm = time.perf_counter(), self.warm[i]
        functions.problem = self.instance(i)
        start = iterate_from(functions.problem, warm)
        flags = [np.full(phase.num_stages + 1, True) for phase in self.compiled.phases]
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            run = Run(
                functions, scaled(self.options, functions.problem, partial(cost_scale, functions)), start, flags, None
            )
            if warm is not None:
                run.resume(warm)
            try:
                status = run.loop()
            except KeyboardInterrupt:
                status = Status.INTERRUPTED
            r, at = self.recorder, run.current
            r.numbers["cost"][i], r.numbers["max_defect"][i] = at.cost, at.max_defect
            r.numbers["max_equality"][i], r.numbers["max_inequality"][i] = run.violations(at)
            for k, (x, u) in enumerate(zip(at.iterate.states, at.iterate.controls, strict=True)):
                r.put(k, i, states=x, controls=u)
            if r.gains:
                for k, phase in enumerate(assemble(run, status, 0.0).phases):
                    r.put(k, i, feedforward=phase.feedforward, feedback=phase.feedback)
            status, r.faults[i] = with_cause(status, functions, at.iterate, run.outer, run.outside)
            self._keep(i, run.outer, status, len(run.history), time.perf_counter() - began)
            r.search[i] = run.search_state()
        return status is Status.INTERRUPTED

    def _keep(self, i: int, outer: Outer, status: Status, iterations: int, solve_s: float) -> None:
        r = self.recorder
        r.status[i], r.iterations[i] = status, iterations
        r.numbers["barrier_weight"][i], r.numbers["solve_s"][i] = outer.weight, solve_s
        for k, dual in enumerate(outer.duals):
            r.put_multipliers(k, i, dual.stored())

    # ---- in C, over threads

    def solve_in_c(self, memory: SolverMemory, threads: int, progress: Callable[[int, int], None] | None) -> None:
        """Solve every instance; Ctrl-C and errors stop the batch when every thread has stopped."""
        library = memory.compiled_library
        memories = [memory] + [SolverMemory(self.compiled, library, self.options) for _ in range(threads - 1)]
        stop, errors = threading.Event(), list[BaseException]()
        following, reported = iter(range(self.size)), 0
        lock = threading.Lock()
        self.done = 0

        def work(own: SolverMemory) -> None:
            try:
                while not stop.is_set():
                    with lock:
                        i = next(following, None)
                    if i is None or not self._solve_one_in_c(own, i, stop):
                        return
                    with lock:
                        self.done += 1
            except BaseException as error:  # the waiting thread raises it
                errors.append(error)
                stop.set()

        workers = [Worker(partial(work, own)) for own in memories]
        try:
            for worker in workers:
                worker.start()
            while True:
                running = [worker for worker in workers if worker.runs]
                if progress is not None and self.done > reported:
                    reported = self.done
                    progress(reported, self.size)
                if not running:
                    break
                running[0].wait(_POLL_S)
        except KeyboardInterrupt:
            pass
        finally:
            stop.set()
            for own in memories:
                own.c.cancel = 1
            for worker in workers:
                worker.wait_out()
        if errors:
            raise errors[0]

    def _solve_one_in_c(self, memory: SolverMemory, i: int, stop: threading.Event) -> bool:
        """Solve instance i; return False if the batch was stopped before its solve began."""
        began, warm = time.perf_counter(), self.warm[i]
        problem = self.instance(i)
        memory.set_numbers(problem)
        options = scaled(self.options, problem, partial(native_scale, memory))
        memory.set_options(options)
        outer = Outer(problem, options)
        if warm is not None:
            outer.resume(warm)
        resumed = write(memory, iterate_from(problem, warm), outer, warm)
        if stop.is_set():  # checked after write(), which clears the request to stop
            return False
        c, r = memory.c, self.recorder
        status = STATUS[memory.library.piaffe_solve(ct.byref(c), resumed)]
        read_outer(memory, outer)
        r.search[i] = read_search(memory)
        r.numbers["cost"][i], r.numbers["max_defect"][i] = c.cost, c.max_defect
        r.numbers["max_equality"][i], r.numbers["max_inequality"][i] = c.max_equality, c.max_inequality
        iterate = read_iterate(memory, memory.accepted)
        for k, (x, u) in enumerate(zip(iterate.states, iterate.controls, strict=True)):
            r.put(k, i, states=x, controls=u)
        iterations = c.num_records
        outside = read_iterate(memory, memory.outside) if status is Status.NOT_FINITE and c.blocked else None
        status, r.faults[i] = with_cause(status, ProblemFunctions(problem), iterate, outer, outside)
        if status is Status.NOT_FINITE:
            r.faults[i] = r.faults[i] or memory.fault()
        if r.gains:
            found = memory.library.piaffe_policy(ct.byref(c))
            for k, own in enumerate(memory.arrays):
                r.put(k, i, feedforward=np.where(found, own["k"], 0.0), feedback=np.where(found, own["K"], 0.0))
        self._keep(i, outer, status, iterations, time.perf_counter() - began)
        return True


def _rows(known: Parameters, name: str, value: ArrayLike) -> Array:
    """Return the values of a parameter, (batch, size)."""
    table, size = numbers_of(value, "solve_batch", f"parameter '{name}'"), known.size(name)
    rows = table[:, None] if table.ndim == 1 and size == 1 else table
    if rows.ndim != 2 or rows.shape[1] != size:
        expected = "(batch,)" if size == 1 else f"(batch, {size})"
        raise ShapeError(
            f"solve_batch: parameter '{name}' has the wrong shape - got {table.shape}, expected {expected}; "
            "give one row per instance"
        )
    return rows


def _warm_start(starts: Starts, i: int) -> WarmStart | None:
    if isinstance(starts, BatchSolution):
        return starts.warm_start(i)
    solution = starts if starts is None or isinstance(starts, Solution) else starts[i]
    return None if solution is None else WarmStart.of(solution)
