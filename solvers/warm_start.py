"""Warm starts: where a solve begins, and whether what was given for it can be used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError
from piaffe.ocp import CompiledProblem

from .iterate import Iterate
from .solution import Solution

Array = NDArray[np.float64]


def first_iterate(problem: CompiledProblem, warm_start: Solution | None) -> Iterate:
    """Return the states and controls to begin with: those of a solution from the problem's start, or the guess.

    Raises:
        SolverError: the solution has other phases or sizes, or is not finite.
    """
    phases = problem.phases
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
    check_finite(problem, warm_start)
    states = [p.states.copy() for p in given]
    states[0][0] = problem.initial
    return Iterate(states, [p.controls.copy() for p in given])


def check_finite(problem: CompiledProblem, warm_start: Solution) -> None:
    """Raise if a number of a warm start is NaN or infinite; name phase, node and component.

    Raises:
        SolverError: one is not.
    """
    for phase, part, policy in zip(problem.phases, warm_start.trajectory.phases, warm_start.phases, strict=True):
        _check(part.name, "state", part.states, phase.mode.state.stored_labels)
        _check(part.name, "control", part.controls, phase.mode.model.control.labels)
        for name, table in policy.multipliers.items():
            if name not in ("inequality", "end_inequality"):  # what the barrier says; the next solve does not read it
                _check(part.name, name.replace("_", " "), np.atleast_2d(table), ())
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
