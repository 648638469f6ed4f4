"""Why a solve ended where it did: the rows that push most, wandering, scales, and a relaxation that helps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from piaffe.ocp import Violation

from .record import Record
from .status import Status

_NAMED = 5
"""How many rows are listed."""
_MARGIN = 1.1
"""A relaxation is this much larger than the linear model needs."""
_MEMORY = 60
"""Iterations over which a search that does not end is judged."""
_FALLS = 0.02
"""It still gets somewhere if cost or violations fall by this share."""
_FAR_APART = 1e6
"""Ratio of the sizes of rows, in units of their scales, above which their scales are named."""


@dataclass(frozen=True)
class Relaxation:
    """A change of one constraint with which, in the linear model of the last iterate, all constraints can hold.

    Args:
        term: name of the constraint.
        amount: distance by which its bounds move outwards, or by which an equality may be missed.
        unit: unit of the distance.
    """

    term: str
    amount: float
    unit: str


def ranked(violations: Sequence[Violation], status: Status) -> list[Violation]:
    """Return the constraints that have an effect, that with the largest first.

    Of a problem without a solution, it is what the constraint takes part in the contradiction: its multipliers times
    its violations. Otherwise it is what the constraint costs: its multipliers times the size of its rows, so that rows
    in newtons and in radians compare.
    """

    def effect(v: Violation) -> float:
        return v.conflict if status is Status.INFEASIBLE or v.kind == "equality" else v.push * v.size

    found = [v for v in violations if v.amount > 0 or effect(v) > 0]
    return sorted(found, key=lambda v: (-effect(v), -v.amount))


def relaxation(violations: Sequence[Violation], status: Status) -> Relaxation | None:
    """Return a relaxation of the constraint that is ranked first; None if no row is violated with a multiplier.

    Multipliers of constraints that contradict each other add up to no force on the trajectory. So the sum of
    multipliers times violations is the same wherever the trajectory is, to first order, and moving one constraint has
    to make up for all of it.
    """
    total, first = sum(v.conflict for v in violations), next(iter(ranked(violations, status)), None)
    if first is None or not first.push > 0 or not total > 0:
        return None
    return Relaxation(first.term, _MARGIN * total / first.push * first.scale, first.unit)


def rows(violations: Sequence[Violation], status: Status) -> Iterator[str]:
    """Yield a line about each of the first constraints by rank."""
    for v in ranked(violations, status)[:_NAMED]:
        unit = f" {v.unit}" if v.unit else ""
        amount = f"violated by {v.amount * v.scale:.3g}{unit}" if v.amount > 0 else "met"
        yield (
            f"- {v.kind} '{v.name}' ({v.source}), phase '{v.phase}', node {v.node}: {amount}; its multiplier is "
            f"{v.multiplier or 0.0:.3g}"
        )


def wandering(history: Sequence[Record]) -> str:
    """Return a sentence if neither cost nor violations have fallen over the last iterations; empty otherwise."""
    if len(history) < 2 * _MEMORY:
        return ""
    before, last = history[:-_MEMORY], history[-_MEMORY:]
    for earlier, later in (
        ([_violation(r) for r in before[-_MEMORY:]], [_violation(r) for r in last]),
        ([r.cost for r in before[-_MEMORY:]], [r.cost for r in last]),
    ):
        if min(later) < min(earlier) - _FALLS * abs(min(earlier)):
            return ""
    steps = float(np.median([r.step_size for r in last]))
    return (
        f"Over the last {_MEMORY} iterations neither cost nor violations fell; the median step was {steps:.2g}. The "
        "search wanders: start from a solution of an easier problem, or check that terms are smooth."
    )


def _violation(record: Record) -> float:
    return max(record.max_equality, record.max_inequality, record.max_defect)


def scales(violations: Sequence[Violation]) -> str:
    """Return a sentence if the rows of two constraints differ in size by many decades; empty otherwise."""
    sized = sorted((v for v in violations if v.kind == "inequality" and v.size > 0), key=lambda v: v.size)
    if len(sized) < 2 or sized[-1].size < _FAR_APART * sized[0].size:
        return ""
    least, most = sized[0], sized[-1]
    return (
        f"Rows differ in size by many decades: '{least.term}' ({least.source}) is at most {least.size:.1e}, "
        f"'{most.term}' ({most.source}) up to {most.size:.1e} in units of their scales; give scale= with their "
        "natural sizes."
    )
