"""The dimensional report: the unit of each term, the unit of its weights, and its size at the initial guess."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..compiler import CompiledPhase, CompiledProblem, Guess, Row, end_values
from ..language import Constraint, Cost

Array = NDArray[np.float64]

_SIMPLE = ("m", "s", "rad", "N", "kg", "J", "W")  # units that need no parentheses


@dataclass(frozen=True)
class CostReport:
    """Unit and size of a cost, at the initial guess.

    Args:
        name: the term's name.
        at: where it applies.
        unit: unit of its residual.
        weight_unit: unit of its weights if the cost has no unit; running costs are rates.
        rows: number of rows.
        weights: smallest and largest positive weight.
        largest: largest |residual| of rows with positive weight.
        cost: its cost over the horizon.
    """

    name: str
    at: str
    unit: str
    weight_unit: str
    rows: int
    weights: tuple[float, float]
    largest: float
    cost: float


@dataclass(frozen=True)
class ConstraintReport:
    """Unit and violations of a constraint, at the initial guess.

    Args:
        name: the term's name.
        kind: ``"inequality"`` or ``"equality"``.
        unit: unit of its rows.
        scale: divisor of violations in reports.
        rows: number of rows.
        counted: number of (row, node) pairs where it applies.
        missed: number of these pairs that the guess violates.
        worst: the largest raw violation [unit].
    """

    name: str
    kind: str
    unit: str
    scale: float
    rows: int
    counted: int
    missed: int
    worst: float


@dataclass(frozen=True, eq=False)
class _Table:
    """Values of one group of rows over nodes: kind, rows (names), values, weights or masks (factor), and time step."""

    kind: str
    rows: tuple[Row, ...]
    values: Array
    factor: Array
    dt: float


def report(compiled: CompiledProblem) -> tuple[list[CostReport], list[ConstraintReport]]:
    """Return the figures of every cost and constraint at the initial guess; rows that models derive are last."""
    tables = [table for phase in compiled.phases for table in _tables(phase)]
    costs, constraints = [], []
    for index in [*range(len(compiled.terms)), -1]:
        parts = [(t, [i for i, row in enumerate(t.rows) if row.term == index]) for t in tables]
        parts = [(t, columns) for t, columns in parts if columns]
        if not parts:
            continue
        term = compiled.terms[index] if index >= 0 else None
        if isinstance(term, Cost):
            costs.append(_cost(term, parts))
        else:
            constraints.append(_constraint(compiled, term, parts))
    return costs, constraints


def _tables(phase: CompiledPhase) -> Iterator[_Table]:
    stage, rows = Guess(phase).stage, phase.mode.rows
    end, end_rows = end_values(phase), phase.end_rows
    yield _Table("cost", rows["stage_residual"], stage["residual"], phase.weight, phase.dt)
    yield _Table("inequality", rows["stage_g"], stage["g"], phase.g_mask, phase.dt)
    yield _Table("equality", rows["stage_h"], stage["h"], phase.h_mask, phase.dt)
    yield _Table("cost", end_rows("residual"), end["residual"], phase.end_weight[None], 1.0)
    yield _Table("inequality", end_rows("g"), end["g"], phase.end_g_mask[None], 1.0)
    yield _Table("equality", end_rows("h"), end["h"], phase.end_h_mask[None], 1.0)


def _cost(term: Cost, parts: list[tuple[_Table, list[int]]]) -> CostReport:
    total, largest, weights = 0.0, 0.0, [np.zeros(0)]
    for table, columns in parts:
        r, w = table.values[:, columns], table.factor[:, columns]
        total += 0.5 * table.dt * float(np.sum(w * r**2))
        largest = max(largest, float(np.max(np.abs(r) * (w > 0), initial=0.0)))
        weights.append(w[w > 0])
    counted = np.concatenate(weights)
    unit = parts[0][0].rows[parts[0][1][0]].unit
    span = (float(counted.min()), float(counted.max())) if counted.size else (0.0, 0.0)
    rows = max(len(columns) for _, columns in parts)
    return CostReport(term.name, term.at, unit, weight_unit(unit, term.at), rows, span, largest, total)


def _constraint(
    compiled: CompiledProblem, term: Constraint | None, parts: list[tuple[_Table, list[int]]]
) -> ConstraintReport:
    counted = missed = 0
    worst = 0.0
    for table, columns in parts:
        value, mask = table.values[:, columns], table.factor[:, columns] > 0
        amount = np.where(mask, -value if table.kind == "inequality" else np.abs(value), 0.0)
        counted += int(mask.sum())
        missed += int(np.sum(amount > 1e-9))
        scales = np.array([table.rows[i].scale for i in columns])
        worst = max(worst, float(np.max(amount * scales, initial=0.0)))
    table, columns = parts[0]
    row = table.rows[columns[0]]
    rows = max(len(columns) for _, columns in parts)
    name = term.name if term is not None else compiled.term_name(row)
    return ConstraintReport(name, table.kind, row.unit, row.scale, rows, counted, missed, worst)


def weight_unit(unit: str, at: str) -> str:
    """Return the unit of a weight for a cost without unit: ``"1/(m^2 s)"`` for a running residual in metres."""
    squared = f"{unit}^2" if unit in _SIMPLE else f"({unit})^2" if unit else ""
    parts = [part for part in (squared, "s" if at == "running" else "") if part]
    if not parts:
        return "1"
    return f"1/({' '.join(parts)})" if len(parts) > 1 else f"1/{parts[0]}"
