"""The state of a search: what a solve knows beside its iterate and multipliers, to go on where it stopped."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from .. import constants


@dataclass(frozen=True, kw_only=True)
class SearchState:
    """What line search, regularisation and outer loop remember from iteration to iteration.

    A warm start takes it up only if its iterate still has the same merit, that is, for the same problem: gains and
    steps say nothing of another.

    Args:
        merit: of the iterate, with the multipliers and weight ρ beside it.
        rho, least_rho: weight of the defects in the merit, and its lower limit.
        regularization: Levenberg regularisation of the next iteration.
        step_size: last accepted step, 0 if the last search failed.
        gains: what the last steps of this sub-problem gained, the newest last.
        inner: iterations of this sub-problem.
        unmoved: solved sub-problems in a row that did not reduce the violation.
        last_equality, last_violation: violations at the last update of the multipliers; infinite before the first.
        last_cost: cost of the last solved sub-problem before ε shrank; None before the first.
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

    def to_json(self) -> dict[str, Any]:
        """Return the state as JSON-able values."""
        return asdict(self)

    @staticmethod
    def from_json(values: dict[str, Any]) -> SearchState:
        """Return the state that ``to_json`` described."""
        return SearchState(**{**values, "gains": tuple(values["gains"])})


def is_same(merit: float, other: float) -> bool:
    """Return whether two merits are of the same iterate of the same problem, but for rounding."""
    return abs(merit - other) <= constants.SAME_MERIT * (1 + abs(other))
