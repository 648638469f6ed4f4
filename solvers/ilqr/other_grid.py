"""The first iterate from a solution on another grid: other time steps, durations, or a part of its phases."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError
from piaffe.ocp import CompiledPhase, CompiledProblem, PhaseTrajectory, interpolate, node_before

from ..solution import Solution
from .iterate import Iterate

Array = NDArray[np.float64]


def fits(problem: CompiledProblem, solution: Solution) -> bool:
    """Return whether a solution has the phases of a problem with the same numbers of stages.

    Raises:
        SolverError: its models are others than those of the problem.
    """
    parts = solution.trajectory.phases
    _check_models(problem, parts)
    sizes = [(p.num_stages, p.mode.state.nx, p.mode.nu) for p in problem.phases]
    return sizes == [(len(p.controls), p.states.shape[1], p.controls.shape[1]) for p in parts]


def interpolated(problem: CompiledProblem, solution: Solution) -> Iterate:
    """Return states and controls from the phases of the same names, at the same share of each phase.

    The n-th phase of a name is taken from the n-th phase of this name and model. States are interpolated on the
    manifold, controls are held. A phase may be longer or shorter, and may have another time step.

    Raises:
        SolverError: a phase has no counterpart.
    """
    parts, states, controls = solution.trajectory.phases, [], []
    found = dict(zip(_numbered((part.name, part.model) for part in parts), parts, strict=True))
    keys = _numbered((phase.name, phase.mode.model.name) for phase in problem.phases)
    for key, phase in zip(keys, problem.phases, strict=True):
        if key not in found:
            raise SolverError(
                f"warm start: does not fit the problem - got a solution with the phases {_told(found)}, expected one "
                f"with phase {key[2] + 1} of '{key[0]}' of model '{key[1]}'; pass a solution of the same phases, or "
                "none"
            )
        x, u = _resampled(phase, found[key])
        states.append(x)
        controls.append(u)
    states[0][0] = problem.initial
    return Iterate(states, controls)


def _numbered(named: Iterable[tuple[str, str]]) -> list[tuple[str, str, int]]:
    """Return each name and model with the number of those before it that are equal."""
    seen: Counter[tuple[str, str]] = Counter()
    numbered = []
    for name, model in named:
        numbered.append((name, model, seen[name, model]))
        seen[name, model] += 1
    return numbered


def _resampled(phase: CompiledPhase, part: PhaseTrajectory) -> tuple[Array, Array]:
    share = np.arange(phase.num_stages + 1) / max(phase.num_stages, 1)
    times = part.times[0] + share * (part.times[-1] - part.times[0])
    states = np.array([interpolate(part, part.states, t) for t in times])
    return states, np.array([part.controls[node_before(part, t)[0]] for t in times[:-1]]).reshape(-1, phase.mode.nu)


def _check_models(problem: CompiledProblem, parts: tuple[PhaseTrajectory, ...]) -> None:
    known = {part.model: part for part in parts}
    for model in dict.fromkeys(phase.mode.model for phase in problem.phases):
        part = known.get(model.name)
        if part is None or part.state.labels != model.state.labels or part.control.labels != model.control.labels:
            what = "of other models" if part is None else f"of another model with the name '{model.name}'"
            raise SolverError(
                f"warm start: is {what} - got {list(known)}, expected '{model.name}' with the state and the control of "
                "the problem; pass a solution of this robot, or none"
            )


def _told(found: Iterable[tuple[str, str, int]]) -> str:
    names = list(dict.fromkeys(f"'{name}' of '{model}'" for name, model, _ in found))
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
