"""MSiLQR: multi-phase multiple-shooting iLQR with augmented Lagrangian and relaxed barrier, in NumPy or in C."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import SolverError
from piaffe.ocp import CompiledProblem, Problem, compile_problem, require_derivatives

from .iterate import Evaluator, Iterate
from .native import Backend, drive, native_machine
from .options import Options
from .record import Record
from .result import assemble
from .rollout import move
from .run import Run
from .solution import Solution
from .status import Status

Flags = NDArray[np.bool_]


class MSiLQR:
    """Multi-phase multiple-shooting iLQR.

    Args:
        problem: a declaration, or one already compiled.
        options: tolerances and parameters.
        backend: ``"native"``: the solver in C, compiled for these modes once and kept; where no compiler works, NumPy
            with a warning. ``"numpy"``: the readable reference. Both make the same iterates.
        building: called while the native backend compiles, with steps done, steps in all and what was done last.
    """

    def __init__(
        self,
        problem: Problem | CompiledProblem,
        options: Options | None = None,
        *,
        backend: Backend = "native",
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
        self.problem = compile_problem(problem) if isinstance(problem, Problem) else problem
        self.evaluator = Evaluator(self.problem)
        self.machine = native_machine(self.problem, self.options, building) if backend == "native" else None

    @property
    def backend(self) -> Backend:
        """Which implementation solves: ``"numpy"`` also where no compiler was found."""
        return "numpy" if self.machine is None else "native"

    def solve(
        self,
        warm_start: Solution | None = None,
        *,
        shooting: bool | Sequence[ArrayLike] = True,
        progress: Callable[[Record], None] | None = None,
    ) -> Solution:
        """Solve the problem.

        Args:
            warm_start: a solution of a problem with the same phases and sizes: states, controls and multipliers to
                begin with. Without it the path through the targets is the start.
            shooting: which nodes are shooting nodes: True for all, False for none (single shooting: the start is rolled
                out), or per phase (N+1,) flags.
            progress: called with every iteration's record.

        Returns:
            The solution; its status says how the solve ended. A solve that does not converge does not raise.

        Raises:
            SolverError: the warm start or the flags do not fit the problem.
        """
        began = time.perf_counter()
        flags = self.flags(shooting)
        start = self.start(warm_start)
        if not all(f.all() for f in flags):
            zero = [np.zeros((p.num_stages + 1, p.mode.state.ndx)) for p in self.problem.phases]
            start = move(self.evaluator, start, zero, [np.zeros_like(u) for u in start.controls], 0.0, flags)
        run = Run(self.evaluator, self.options, start, flags, progress)
        if warm_start is not None:
            run.outer.resume(warm_start)
        try:
            if self.machine is not None and all(f.all() for f in flags):
                status = drive(self.machine, run, warm_start is not None, progress)
            else:
                status = run.loop()
        except KeyboardInterrupt:
            status = Status.INTERRUPTED
        return assemble(run, status, time.perf_counter() - began)

    def start(self, warm_start: Solution | None) -> Iterate:
        """Return the states and controls to begin with."""
        phases = self.problem.phases
        if warm_start is None:
            return Iterate([p.guess_states for p in phases], [p.guess_controls for p in phases])
        given = warm_start.trajectory.phases
        sizes = [(p.name, p.num_stages, p.mode.state.nx, p.mode.nu) for p in phases]
        got = [(p.name, len(p.controls), p.states.shape[1], p.controls.shape[1]) for p in given]
        if [s[1:] for s in sizes] != [g[1:] for g in got]:
            raise SolverError(
                f"warm start: does not fit the problem - got phases {got}, expected {sizes} (name, stages, nx, nu); "
                "pass a solution of the same phases, or none"
            )
        states = [p.states.copy() for p in given]
        states[0][0] = self.problem.initial
        return Iterate(states, [p.controls.copy() for p in given])

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
