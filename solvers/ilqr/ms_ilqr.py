"""MSiLQR: multi-phase multiple-shooting iLQR with augmented Lagrangian and relaxed barrier, in NumPy or in C."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from threading import Lock

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import SolverError
from piaffe.interrupts import interruptible
from piaffe.ocp import (
    CompiledProblem,
    Problem,
    check_numbers,
    compile_problem,
    early_warnings,
    find_warnings,
    require_derivatives,
)

from ..solution import Record, Solution, Status
from .cause import with_cause
from .iterate import Iterate, ProblemFunctions
from .native import Backend, native_memory, native_scale, run_native
from .options import Options
from .other_grid import fits, interpolated
from .result import assemble
from .rollout import move
from .run import Run
from .scale import cost_scale, scaled
from .warm_start import WarmStart, first_iterate
from .warned import issue

Flags = NDArray[np.bool_]


class MSiLQR:
    """Multi-phase multiple-shooting iLQR.

    Args:
        problem: a declaration, or one already compiled.
        options: tolerances and parameters.
        backend: ``"native"``: the solver in C, compiled once for the modes of the problem and cached; NumPy, with a
            warning, if no compiler works. ``"numpy"``: the readable reference. Both have the same iterates.
        compiling: called while the problem compiles, with the number of compiled phases, of all phases, and a name.
        building: called while the native backend compiles, with the number of finished steps, the number of all steps,
            and the name of the last finished step.

    What is likely a mistake in the problem is issued as ``piaffe.PiaffeWarning``, with file and line; the attribute
    ``warnings`` has the same as values.

    Raises:
        SolverError: the problem or the backend is not one.
        ProblemError: the problem does not compile, or a model of it has no derivatives.
    """

    @interruptible()
    def __init__(
        self,
        problem: Problem | CompiledProblem,
        options: Options | None = None,
        *,
        backend: Backend = "native",
        compiling: Callable[[int, int, str], None] | None = None,
        building: Callable[[int, int, str], None] | None = None,
    ) -> None:
        if backend not in ("native", "numpy"):
            raise SolverError(f"MSiLQR: backend is unknown - got {backend!r}, expected 'native' or 'numpy'; choose one")
        if not isinstance(problem, Problem | CompiledProblem):
            raise SolverError(
                f"{type(self).__name__}: not a problem - got {type(problem).__name__}, expected an ocp.Problem; "
                "declare one"
            )
        require_derivatives(problem, type(self).__name__)
        self.options = options or Options()
        early = issue(early_warnings(problem)) if isinstance(problem, Problem) else []
        self.problem = compile_problem(problem, progress=compiling) if isinstance(problem, Problem) else problem
        self.warnings = early + issue(find_warnings(self.problem))
        self.functions = ProblemFunctions(self.problem)
        self.memory = native_memory(self.problem, self.options, building) if backend == "native" else None
        self._idle = Lock()
        self._absolute: Options | None = None

    def __reduce__(self) -> tuple[object, ...]:  # another process makes its own memory
        return _made, (type(self), self.problem, self.options, self.backend)

    @property
    def backend(self) -> Backend:
        """The implementation in use; ``"numpy"`` also if no compiler was found."""
        return "numpy" if self.memory is None else "native"

    def solve(
        self,
        warm_start: Solution | None = None,
        *,
        shooting: bool | Sequence[ArrayLike] = True,
        progress: Callable[[Record], None] | None = None,
    ) -> Solution:
        """Solve the problem.

        Args:
            warm_start: a solution of the same phases; its states, controls and multipliers are the first iterate. If
                it has other time steps or durations, states and controls are interpolated, phase by phase. Without
                it, the first iterate is the path through the targets.
            shooting: which nodes are shooting nodes: True for all, False for none (single shooting: the first iterate
                is a roll-out), or flags per phase, (N+1,).
            progress: called with the record of every iteration.

        Returns:
            The solution; its status is the reason why the solve ended. A solve that does not converge does not raise.

        Raises:
            SolverError: the warm start or the flags do not fit the problem, the warm start is not finite, or another
                thread runs this method of this object.
            ProblemError: a number of the problem is not finite.
        """
        began = time.perf_counter()
        check_numbers(self.problem)
        if not self._idle.acquire(blocking=False):
            raise SolverError(
                "MSiLQR.solve: a solve is running - got a second call from another thread, expected one call at a "
                "time, because they share memory; make an MSiLQR for each thread, or use solvers.solve_batch"
            )
        try:
            with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # for trials, see Status.NOT_FINITE
                return self._solve(warm_start, shooting, progress, began)
        finally:
            self._idle.release()

    def _solve(
        self,
        warm_start: Solution | None,
        shooting: bool | Sequence[ArrayLike],
        progress: Callable[[Record], None] | None,
        began: float,
    ) -> Solution:
        flags = self.flags(shooting)
        start, from_earlier = self._start(warm_start)
        if not all(f.all() for f in flags):
            zero = [np.zeros((p.num_stages + 1, p.mode.state.ndx)) for p in self.problem.phases]
            start = move(self.functions, start, zero, [np.zeros_like(u) for u in start.controls], 0.0, flags)
        run = Run(self.functions, self.scaled_options(), start, flags, progress)
        if from_earlier is not None:
            run.resume(from_earlier)
        try:
            status = run.loop() if self.memory is None else run_native(self.memory, run, from_earlier, progress)
        except KeyboardInterrupt:
            status = Status.INTERRUPTED
        status, found = with_cause(status, self.functions, run.current.iterate, run.outer, run.outside)
        if status is Status.NOT_FINITE and not found and self.memory is not None:
            found = self.memory.fault()
        return replace(assemble(run, status, time.perf_counter() - began), fault=found)

    def scaled_options(self) -> Options:
        """Return the options in the unit of the problem's cost, see :class:`Options`; computed once."""
        if self._absolute is None:
            memory = self.memory
            self._absolute = scaled(
                self.options, self.problem,
                lambda: cost_scale(self.functions) if memory is None else native_scale(memory),
            )  # fmt: skip
            if memory is not None:
                memory.set_options(self._absolute)
        return self._absolute

    def start(self, warm_start: Solution | None) -> Iterate:
        """Return the states and controls of the first iterate."""
        return self._start(warm_start)[0]

    def _start(self, warm_start: Solution | None) -> tuple[Iterate, WarmStart | None]:
        """Return the first iterate, and what a solve takes up of a solution on the same grid."""
        if warm_start is not None and not fits(self.problem, warm_start):
            return interpolated(self.problem, warm_start), None
        earlier = None if warm_start is None else WarmStart.of(warm_start)
        return first_iterate(self.problem, earlier), earlier

    def flags(self, shooting: bool | Sequence[ArrayLike]) -> list[Flags]:
        """Return which nodes are shooting nodes, per phase (N+1,)."""
        sizes = [phase.num_stages + 1 for phase in self.problem.phases]
        if isinstance(shooting, bool):
            return [np.full(size, shooting) for size in sizes]
        flags = [np.asarray(f, dtype=bool) for f in shooting]
        if [f.shape for f in flags] != [(size,) for size in sizes]:
            raise SolverError(
                f"shooting: flags do not fit the phases - got shapes {[f.shape for f in flags]}, expected "
                f"{[(size,) for size in sizes]}; give one flag per node and phase"
            )
        return flags


def _made(kind: type[MSiLQR], problem: CompiledProblem, options: Options, backend: Backend) -> MSiLQR:
    return kind(problem, options, backend=backend)
