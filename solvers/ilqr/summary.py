"""Summary of a solution: the cost of each named term, the violation of each named constraint, and the trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
from .iterate import Iterate, PhaseDual, PhaseValues, ProblemFunctions, masked

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
    found: dict[tuple[str, Kind], _Constraint] = {}
    for phase, value, dual in zip(problem.phases, values, duals, strict=True):
        for group in _groups(phase, value, dual, weight):
            columns: dict[str, list[int]] = {}
            for j, row in enumerate(group.rows):
                columns.setdefault(problem.term_name(row), []).append(j)
            for name, own in columns.items():
                key = name, group.kind
                found.setdefault(key, _Constraint(*key)).add(problem, phase, group, own)
    each = [constraint.violation() for constraint in found.values()]
    return tuple(sorted(each, key=lambda v: -v.amount))


@dataclass(frozen=True, eq=False)
class _Group:
    """Rows of one kind at the stages or at the last node of a phase; tables are (nodes, rows), sums are (rows,).

    Args:
        rows: what they are.
        kind: their kind.
        first: the first node.
        amounts: violations. multipliers: as they are. pushes: after the next update, times the time step.
        sizes: largest absolute values.
    """

    rows: tuple[Row, ...]
    kind: Kind
    first: int
    amounts: Array
    multipliers: Array
    pushes: Array
    sizes: Array

    @staticmethod
    def of(
        rows: tuple[Row, ...],
        kind: Kind,
        values: Array,
        used: Array,
        multipliers: tuple[Array, Array],
        time: float,
        first: int,
    ) -> _Group:
        """Return a group from its values, masks, and multipliers now and after the next update."""
        missed = np.maximum(-values, 0.0) if kind == "inequality" else np.abs(values)
        return _Group(
            rows, kind, first, masked(used, missed), multipliers[0], masked(used, np.abs(multipliers[1])) * time,
            np.max(masked(used, np.abs(values)), axis=0, initial=0.0),
        )  # fmt: skip


def _groups(phase: CompiledPhase, value: PhaseValues, dual: PhaseDual, weight: float) -> tuple[_Group, ...]:
    now, end_now = inequality_multipliers(value, dual, weight)
    met = replace(value, g=np.maximum(value.g, 0.0), end_g=np.maximum(value.end_g, 0.0))
    later, end_later = inequality_multipliers(met, dual, weight)  # an update keeps the multiplier at g = 0
    own, n, dt = phase.mode.rows, phase.num_stages, phase.dt
    h, end_h = dual.multiplier, dual.end_multiplier[None]
    return (
        _Group.of(own["stage_g"], "inequality", value.g, phase.g_mask, (now, later), dt, 0),
        _Group.of(own["stage_h"], "equality", value.h, phase.h_mask, (h, h), dt, 0),
        _Group.of(phase.end_rows("g"), "inequality", value.end_g[None], phase.end_g_mask[None],
                  (end_now[None], end_later[None]), dt, n),
        _Group.of(phase.end_rows("h"), "equality", value.end_h[None], phase.end_h_mask[None], (end_h, end_h), 1.0, n),
    )  # fmt: skip


@dataclass(eq=False)
class _Constraint:
    """What is known of one named constraint: its worst violation, and sums over its rows and nodes."""

    term: str
    kind: Kind
    worst: Violation | None = None
    push: float = 0.0
    conflict: float = 0.0
    size: float = 0.0
    rank: tuple[float, float] = (0.0, 0.0)

    def add(self, problem: CompiledProblem, phase: CompiledPhase, group: _Group, columns: list[int]) -> None:
        """Take up rows of a group."""
        amounts, pushes = group.amounts[:, columns], group.pushes[:, columns]
        self.push += float(np.sum(pushes))
        self.conflict += float(np.sum(pushes * amounts))
        self.size = max(self.size, float(np.max(group.sizes[columns])))
        by = amounts if np.any(amounts > 0) else pushes
        node, column = (int(k) for k in np.unravel_index(int(np.argmax(by)), by.shape))
        rank = float(amounts[node, column]), float(pushes[node, column])
        if self.worst is None or rank > self.rank:
            row = group.rows[columns[column]]
            source = str(problem.terms[row.term].source) if row.term >= 0 else "derived from the contact sequence"
            self.rank = rank
            self.worst = Violation(
                problem.row_name(row), phase.name, group.first + node, rank[0], row.unit, self.kind, source,
                float(group.multipliers[node, columns[column]]), term=self.term, scale=row.scale,
            )  # fmt: skip

    def violation(self) -> Violation:
        """Return the worst violation with the sums."""
        assert self.worst is not None  # a row has been added
        return replace(self.worst, push=self.push, conflict=self.conflict, size=self.size)


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
    slices = phase.mode.layout.slices
    bounds: dict[str, list[float | None] | None] = {}
    for key in (ParameterKey("lower", term=k), ParameterKey("upper", term=k)):
        if key in slices:
            bounds[key.kind] = _numbers(phase.p[0, slices[key]], phase.p[0, slices[key.has_bound]])
    own = {key.name: phase.p[0, part] for key, part in slices.items() if key.term == k and key.kind == "parameter"}
    rows = [
        row
        for group in ("stage_g", "stage_h", "terminal_g", "terminal_h")
        for row in phase.mode.rows[group]
        if row.term == k
    ]
    varying: dict[str, Any] = {
        key.kind: over_time(problem, k, key) for key in problem.changing if key.is_bound and key.term == k
    }
    bounds.update(dict.fromkeys(varying))  # they have no one value
    return {
        "name": term.name, "kind": term.kind, "unit": term.unit, "model": phase.mode.model.name,
        "labels": list(dict.fromkeys(row.label for row in rows)),
        "lower": bounds.get("lower"), "upper": bounds.get("upper"),
        "parameters": {name: own.get(name, value).tolist() for name, value in term.parameters.items()},
        "over_time": varying,
    }  # fmt: skip


def over_time(problem: CompiledProblem, k: int, key: ParameterKey) -> dict[str, list[Any]]:
    """Return times [s] and bounds of a constraint that vary over phases, at the nodes where it applies."""
    times: list[float] = []
    values: list[list[float | None]] = []
    for phase in problem.phases:
        if key not in phase.mode.layout.slices:
            continue
        part, has = (phase.mode.layout.slices[each] for each in (key, key.has_bound))
        for t, p, applies in zip(phase.times, np.vstack([phase.p, phase.p_end]), phase.applies[:, k], strict=True):
            times.append(float(t))
            values.append(_numbers(p[part], p[has] * applies))
    return {"times": times, "values": values}


def _numbers(values: Array, has: Array) -> list[float | None]:
    return [float(v) if h else None for v, h in zip(values, has, strict=True)]
