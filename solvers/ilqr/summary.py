"""Summary of a solution: the cost of each named term, the violation of each named constraint, and the trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import (
    CompiledPhase,
    CompiledProblem,
    Constraint,
    Kind,
    ParameterKey,
    PhaseTrajectory,
    Quantity,
    Row,
    Trajectory,
    Violation,
)

from . import barrier
from .iterate import Iterate, PhaseDual, PhaseValues, ProblemFunctions

Array = NDArray[np.float64]


def term_costs(problem: CompiledProblem, values: list[PhaseValues]) -> dict[str, float]:
    """Return the declared cost by term; the costs of terms with the same name are added."""
    costs: dict[str, float] = {}
    for phase, value in zip(problem.phases, values, strict=True):
        groups = (
            (phase.mode.rows["stage_residual"], 0.5 * phase.dt * np.sum(phase.weight * value.residual**2, axis=0)),
            (phase.end_rows("residual"), 0.5 * phase.end_weight * value.end_residual**2),
        )
        for rows, amounts in groups:
            for row, amount in zip(rows, amounts, strict=True):
                name = problem.term_name(row)
                costs[name] = costs.get(name, 0.0) + float(amount)
    return costs


def inequality_multipliers(value: PhaseValues, dual: PhaseDual, weight: float) -> tuple[Array, Array]:
    """Return λ = −ε β'(g − s) of the stages (per unit of time) and of the last node."""
    stages = -weight * barrier.slope(value.g - dual.shift, dual.relaxation)
    return stages, -weight * barrier.slope(value.end_g - dual.end_shift, dual.end_relaxation)


def violations(
    problem: CompiledProblem, values: list[PhaseValues], duals: list[PhaseDual], weight: float
) -> tuple[Violation, ...]:
    """Return the worst violation of each named constraint, worst first."""
    worst: dict[tuple[str, str], Violation] = {}
    for phase, value, dual in zip(problem.phases, values, duals, strict=True):
        stage_lambda, end_lambda = inequality_multipliers(value, dual, weight)
        n = phase.num_stages
        own, end_g, end_h = phase.mode.rows, phase.end_rows("g"), phase.end_rows("h")
        tables: tuple[tuple[tuple[Row, ...], Kind, Array, Array, int], ...] = (
            (own["stage_g"], "inequality", np.maximum(-value.g, 0) * phase.g_mask, stage_lambda, 0),
            (own["stage_h"], "equality", np.abs(value.h) * phase.h_mask, dual.multiplier, 0),
            (end_g, "inequality", (np.maximum(-value.end_g, 0) * phase.end_g_mask)[None], end_lambda[None], n),
            (end_h, "equality", (np.abs(value.end_h) * phase.end_h_mask)[None], dual.end_multiplier[None], n),
        )
        for rows, kind, amounts, multipliers, first in tables:
            for j, row in enumerate(rows):
                node = int(np.argmax(amounts[:, j]))
                amount = float(amounts[node, j])
                name = problem.term_name(row)
                known = worst.get((name, kind))
                if known is None or amount > known.amount:
                    source = (
                        str(problem.terms[row.term].source) if row.term >= 0 else "derived from the contact sequence"
                    )
                    worst[name, kind] = Violation(
                        problem.row_name(row),
                        phase.name,
                        first + node,
                        amount,
                        row.unit,
                        kind,
                        source,
                        float(multipliers[node, j]),
                    )
    return tuple(sorted(worst.values(), key=lambda v: -v.amount))


def trajectory(functions: ProblemFunctions, iterate: Iterate, values: list[PhaseValues]) -> Trajectory:
    """Return the trajectory of an iterate."""
    parts = []
    for phase, x, u, value in zip(functions.problem.phases, iterate.states, iterate.controls, values, strict=True):
        outputs: dict[Quantity, Array] = {}
        if phase.mode.outputs:
            (stacked,) = functions.call(phase.mode.functions["outputs"], x[:-1], u, value.z, phase.p)
            outputs = _split(phase.mode.outputs, stacked)
        labels = {of: each for (of, _), each in zip(phase.mode.outputs, phase.mode.output_labels, strict=True)}
        at_reset: dict[Quantity, Array] = {}
        if phase.transition is not None and phase.lands and phase.transition.outputs:
            of, z = phase.transition.functions["outputs"], value.z_reset[None]
            (stacked,) = functions.call(of, x[-1:], z, phase.p_transition[None])
            at_reset = {quantity: values[0] for quantity, values in _split(phase.transition.outputs, stacked).items()}
            labels |= dict(zip(at_reset, phase.transition.output_labels, strict=True))
        parts.append(
            PhaseTrajectory(
                name=phase.name, mode=phase.label, model=phase.mode.model.name, times=phase.times, states=x.copy(),
                controls=u.copy(), outputs=outputs, state=phase.mode.state, control=phase.mode.model.control,
                ends_phase=phase.ends_phase, reset_outputs=at_reset, output_labels=labels,
            )
        )  # fmt: skip
    return Trajectory(tuple(parts))


def _split(sizes: Sequence[tuple[Quantity, int]], stacked: Array) -> dict[Quantity, Array]:
    """Return the columns of each quantity."""
    found, first = {}, 0
    for quantity, size in sizes:
        found[quantity] = stacked[:, first : first + size]
        first += size
    return found


def limits(problem: CompiledProblem) -> tuple[dict[str, Any], ...]:
    """Return bounds, labels and parameters of the constraints as values that JSON can store, for plots."""
    out = []
    for mode in dict.fromkeys(phase.mode for phase in problem.phases):
        phase = next(p for p in problem.phases if p.mode is mode)
        for k in (k for k in mode.bound if isinstance(problem.terms[k], Constraint)):
            out.append(_limit(problem, phase, k))
    return tuple(out)


def _limit(problem: CompiledProblem, phase: CompiledPhase, k: int) -> dict[str, Any]:
    term = problem.terms[k]
    assert isinstance(term, Constraint)  # picked by the caller
    slices, bounds = phase.mode.layout.slices, {}
    for key in (ParameterKey("lower", term=k), ParameterKey("upper", term=k)):
        if key in slices:
            has, values = phase.p[0, slices[key.has_bound]], phase.p[0, slices[key]]
            bounds[key.kind] = [float(v) if h else None for v, h in zip(values, has, strict=True)]
    own = {key.name: phase.p[0, part] for key, part in slices.items() if key.term == k and key.kind == "parameter"}
    rows = [
        row
        for group in ("stage_g", "stage_h", "terminal_g", "terminal_h")
        for row in phase.mode.rows[group]
        if row.term == k
    ]
    return {
        "name": term.name, "kind": term.kind, "unit": term.unit, "model": phase.mode.model.name,
        "labels": list(dict.fromkeys(row.label for row in rows)),
        "lower": bounds.get("lower"), "upper": bounds.get("upper"),
        "parameters": {name: own.get(name, value).tolist() for name, value in term.parameters.items()},
    }  # fmt: skip
