"""Warm starts: the first iterate of a solve, and the checks of an earlier solution for this use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError
from piaffe.ocp import CompiledProblem

from ..solution import SearchState, Solution
from .iterate import Iterate

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WarmStart:
    """The parts of an earlier solution from which a solve can start.

    Args:
        names: names of the phases.
        states, controls: per phase (N+1, nx) and (N, nu).
        multipliers: per phase, as in a :class:`PhaseSolution`.
        barrier_weight: ε. cost: declared cost of the iterate. converged: whether the earlier solve converged.
        search: the state of the search; None if it is not known.
    """

    names: Sequence[str]
    states: Sequence[Array]
    controls: Sequence[Array]
    multipliers: Sequence[Mapping[str, Array]]
    barrier_weight: float
    cost: float
    converged: bool
    search: SearchState | None

    @staticmethod
    def of(solution: Solution) -> WarmStart:
        """Return the parts of a solution."""
        parts = solution.trajectory.phases
        return WarmStart(
            names=[part.name for part in parts], states=[part.states for part in parts],
            controls=[part.controls for part in parts], multipliers=[phase.multipliers for phase in solution.phases],
            barrier_weight=solution.barrier_weight, cost=solution.cost, converged=solution.converged,
            search=solution.search,
        )  # fmt: skip


def first_iterate(problem: CompiledProblem, warm_start: WarmStart | None) -> Iterate:
    """Return the first iterate: the guess, or an earlier solution with the initial state of the problem.

    Raises:
        SolverError: the earlier solution has other phases or sizes, or is not finite.
    """
    if warm_start is None:
        return iterate_from(problem, None)
    sizes = [(p.name, p.num_stages, p.mode.state.nx, p.mode.nu) for p in problem.phases]
    got = [
        (name, len(u), x.shape[1], u.shape[1])
        for name, x, u in zip(warm_start.names, warm_start.states, warm_start.controls, strict=True)
    ]
    if [s[1:] for s in sizes] != [g[1:] for g in got]:
        raise SolverError(
            f"warm start: does not fit the problem - got phases {got}, expected {sizes} (name, stages, nx, nu); "
            "pass a solution of the same phases, or none"
        )
    check_finite(problem, warm_start)
    return iterate_from(problem, warm_start)


def iterate_from(problem: CompiledProblem, warm_start: WarmStart | None) -> Iterate:
    """Return the first iterate, without checks."""
    if warm_start is None:
        return Iterate([p.guess_states for p in problem.phases], [p.guess_controls for p in problem.phases])
    states = [x.copy() for x in warm_start.states]
    states[0][0] = problem.initial
    return Iterate(states, [u.copy() for u in warm_start.controls])


def check_finite(problem: CompiledProblem, warm_start: WarmStart) -> None:
    """Check that all numbers of a warm start are finite.

    Raises:
        SolverError: one is NaN or infinite; the message names phase, node and component.
    """
    for i, phase in enumerate(problem.phases):
        name = warm_start.names[i]
        _check(name, "state", warm_start.states[i], phase.mode.state.stored_labels)
        _check(name, "control", warm_start.controls[i], phase.mode.model.control.labels)
        for kind, table in warm_start.multipliers[i].items():
            if kind not in ("inequality", "end_inequality"):  # results of the barrier, which a solve does not use
                _check(name, kind.replace("_", " "), np.atleast_2d(table), ())
    if not np.isfinite(warm_start.barrier_weight):
        raise SolverError(
            f"warm start: barrier weight is not finite - got {warm_start.barrier_weight}, expected a positive number; "
            "pass another solution, or none"
        )


def _check(phase: str, what: str, table: Array, labels: tuple[str, ...]) -> None:
    if np.all(np.isfinite(table)):
        return
    node, entry = (int(k) for k in np.argwhere(~np.isfinite(table))[0])
    name = f" '{labels[entry].strip()}'" if labels else f", row {entry}"
    raise SolverError(
        f"warm start, phase '{phase}', node {node}, {what}{name}: is not finite - got {table[node, entry]}, expected "
        "finite numbers; pass another solution, or none"
    )
