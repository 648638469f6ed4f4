"""Results of many solves of one problem, as arrays; row i is instance i."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError
from piaffe.ocp import CompiledPhase, CompiledProblem

from ..ilqr import WarmStart
from ..solution import SearchState, Status

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BatchPhase:
    """One phase of every instance, with N stages.

    Args:
        name: name of the phase.
        times: (N+1,) [s].
        states: (batch, N+1, nx). controls: (batch, N, nu).
        feedforward: k (batch, N, nu). feedback: K (batch, N, nu, ndx). Both are None without ``gains=True``.
        multipliers: as in a :class:`PhaseSolution`, with the batch as first axis; a warm start uses them.
    """

    name: str
    times: Array
    states: Array
    controls: Array
    feedforward: Array | None
    feedback: Array | None
    multipliers: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class BatchSolution:
    """The result of :func:`solve_batch`.

    If the batch was interrupted, an instance that had not started has the status ``INTERRUPTED``, no iteration, and NaN
    in all arrays; an instance that was running has its last iterate.

    Args:
        status: the reason why each instance ended.
        iterations: (batch,).
        cost: declared cost (batch,).
        max_defect, max_equality, max_inequality: (batch,), as in a :class:`Solution`.
        phases: trajectories.
        barrier_weight: last ε (batch,).
        faults: for instances with status ``NOT_FINITE`` or ``UNSTABLE``, a sentence about the cause; else empty.
        search: state of each search; None for instances that had not started.
        solve_s: time of each instance on its thread (batch,) [s]. wall_s: time of the whole batch [s].
        threads: number of threads.
    """

    status: tuple[Status, ...]
    iterations: NDArray[np.int64]
    cost: Array
    max_defect: Array
    max_equality: Array
    max_inequality: Array
    phases: tuple[BatchPhase, ...]
    barrier_weight: Array
    faults: tuple[str, ...]
    search: tuple[SearchState | None, ...]
    solve_s: Array
    wall_s: float
    threads: int

    def __len__(self) -> int:
        return len(self.status)

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Whether each instance met every tolerance, (batch,)."""
        return np.array([status is Status.CONVERGED for status in self.status], dtype=bool)

    @property
    def states(self) -> Array:
        """States of all phases stacked; only for phases of one state size, (batch, nodes, nx)."""
        return np.concatenate([phase.states for phase in self.phases], axis=1)

    @property
    def controls(self) -> Array:
        """Controls of all phases stacked; only for phases of one control size, (batch, stages, nu)."""
        return np.concatenate([phase.controls for phase in self.phases], axis=1)

    def warm_start(self, i: int) -> WarmStart | None:
        """Return the warm start from the result of instance i; None if the instance had not started."""
        search = self.search[i]
        if search is None:
            return None
        return WarmStart(
            names=[phase.name for phase in self.phases], states=[phase.states[i] for phase in self.phases],
            controls=[phase.controls[i] for phase in self.phases],
            multipliers=[{name: table[i] for name, table in phase.multipliers.items()} for phase in self.phases],
            barrier_weight=float(self.barrier_weight[i]), cost=float(self.cost[i]),
            converged=self.status[i] is Status.CONVERGED, search=search,
        )  # fmt: skip

    def raise_if_failed(self) -> BatchSolution:
        """Return the solution; raise SolverError with the explanation if an instance has not converged."""
        if not self.converged.all():
            raise SolverError(self.explain())
        return self

    def explain(self) -> str:
        """Return a text with the number of instances per status, and their indices."""
        lines = []
        for status, count in Counter(self.status).most_common():
            which = [i for i, other in enumerate(self.status) if other is status]
            shown = ", ".join(map(str, which[:8])) + (", ..." if count > 8 else "")
            lines.append(f"{count} of {len(self)}: {status.advice}" + ("" if count == len(self) else f" ({shown})"))
            lines += [f"- instance {i}: {self.faults[i]}" for i in which[:8] if self.faults[i]]
        return "\n".join(lines)

    def __str__(self) -> str:
        rate = len(self) / self.wall_s if self.wall_s > 0 else float("nan")
        return (
            f"{int(self.converged.sum())} of {len(self)} converged in {self.wall_s:.2f} s on {self.threads} threads, "
            f"{rate:.1f} per second\n{self.explain()}"
        )


class BatchRecorder:
    """Arrays of a running batch; each thread fills the rows of its instances.

    Args:
        problem: the problem.
        size: number of instances.
        gains: whether feedforward and feedback are stored.
    """

    def __init__(self, problem: CompiledProblem, size: int, gains: bool) -> None:
        self.problem, self.size, self.gains = problem, size, gains
        self.status = [Status.INTERRUPTED] * size
        self.iterations = np.zeros(size, dtype=np.int64)
        self.numbers = {
            name: np.full(size, np.nan)
            for name in ("cost", "max_defect", "max_equality", "max_inequality", "barrier_weight", "solve_s")
        }
        self.faults = [""] * size
        self.search: list[SearchState | None] = [None] * size
        self.arrays = [self._of_phase(i) for i in range(len(problem.phases))]
        self.multipliers = [self._multipliers_of_phase(phase) for phase in problem.phases]

    def _of_phase(self, i: int) -> dict[str, Array]:
        phase, size = self.problem.phases[i], self.size
        n, nx, ndx, nu = phase.num_stages, phase.mode.state.nx, phase.mode.state.ndx, phase.mode.nu
        shapes: dict[str, tuple[int, ...]] = {"states": (n + 1, nx), "controls": (n, nu)}
        if self.gains:
            shapes |= {"feedforward": (n, nu), "feedback": (n, nu, ndx)}
        return {name: np.full((size, *shape), np.nan) for name, shape in shapes.items()}

    def _multipliers_of_phase(self, phase: CompiledPhase) -> dict[str, Array]:
        tables = {
            "equality": phase.h_mask, "end_equality": phase.end_h_mask, "penalty": phase.h_mask,
            "end_penalty": phase.end_h_mask, "relaxation": phase.g_mask, "end_relaxation": phase.end_g_mask,
            "shift": phase.g_mask, "end_shift": phase.end_g_mask,
        }  # fmt: skip
        return {name: np.full((self.size, *table.shape), np.nan) for name, table in tables.items()}

    def put(self, i: int, row: int, **arrays: Array) -> None:
        """Store arrays of phase i of an instance."""
        for name, array in arrays.items():
            self.arrays[i][name][row] = array.reshape(self.arrays[i][name].shape[1:])

    def put_multipliers(self, i: int, row: int, multipliers: Mapping[str, Array]) -> None:
        """Store the multipliers of phase i of an instance."""
        for name, array in multipliers.items():
            self.multipliers[i][name][row] = array

    def solution(self, wall_s: float, threads: int) -> BatchSolution:
        """Return the results so far."""
        phases = tuple(
            BatchPhase(
                name=phase.name, times=phase.times, states=own["states"], controls=own["controls"],
                feedforward=own.get("feedforward"), feedback=own.get("feedback"), multipliers=multipliers,
            )
            for phase, own, multipliers in zip(self.problem.phases, self.arrays, self.multipliers, strict=True)
        )  # fmt: skip
        return BatchSolution(
            status=tuple(self.status), iterations=self.iterations, phases=phases, faults=tuple(self.faults),
            search=tuple(self.search), wall_s=wall_s, threads=threads, **self.numbers,
        )  # fmt: skip
