"""The state of a search: with it, the iterate and the multipliers, a solve continues where it stopped."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from .. import constants


@dataclass(frozen=True, kw_only=True)
class SearchState:
    """The state of line search, regularisation and outer loop between two iterations.

    A warm start uses it only if its iterate has the same merit, that is, in the same problem: the last steps of one
    problem have no meaning for another.

    Args:
        merit: merit of the iterate with these multipliers and this weight ρ.
        rho, least_rho: weight of the defects in the merit, and its lower limit.
        regularization: Levenberg regularisation of the next iteration.
        step_size: last accepted step, 0 if the last search failed.
        gains: decrease of the merit in the last steps of this sub-problem, the newest last.
        inner: number of iterations in this sub-problem.
        unmoved: number of solved sub-problems since the last one that reduced the violation.
        last_equality, last_violation: violations at the last update of the multipliers; infinite before the first.
        last_cost: cost of the last solved sub-problem before ε shrank; None before the first.
        last_inequality: violation of inequalities after the last solved sub-problem; infinite before the first.
        stiffness: limit of the curvature of violated rows; 0 for the first one.
    """

    merit: float
    rho: float
    least_rho: float
    regularization: float
    step_size: float
    gains: tuple[float, ...]
    inner: int
    unmoved: int
    last_equality: float
    last_violation: float
    last_cost: float | None
    last_inequality: float = float("inf")
    stiffness: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Return the state as values for JSON."""
        return asdict(self)

    @staticmethod
    def from_json(values: dict[str, Any]) -> SearchState:
        """Return the state from the values of ``to_json``."""
        return SearchState(**{**values, "gains": tuple(values["gains"])})


def is_same(merit: float, other: float, size: float) -> bool:
    """Return whether two merits are equal up to rounding: then they are of one iterate of one problem.

    Args:
        merit: a merit.
        other: the other one.
        size: what changes of the merit are relative to.
    """
    return abs(merit - other) <= constants.SAME_MERIT * size
