"""Objective and Constraints: ordered sets of terms."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from piaffe.errors import ProblemError

from .source import caller
from .term import Constraint, Cost, Residual, Term
from .user_input import brief


@dataclass(frozen=True, init=False)
class Objective:
    """A sum of costs: ``ocp.Objective(ocp.track(...), ocp.regularize(...))``."""

    terms: tuple[Cost, ...]

    def __init__(self, *terms: Cost | Objective) -> None:
        object.__setattr__(
            self, "terms", _flatten(terms, Cost, "objective", "ocp.track, ocp.regularize or .weighted()")
        )

    def __add__(self, other: Cost | Objective) -> Objective:
        return Objective(self, other)

    def __iter__(self) -> Iterator[Cost]:
        return iter(self.terms)


@dataclass(frozen=True, init=False)
class Constraints:
    """A set of constraints: ``ocp.Constraints(models.torque_limits(), knee_clearance)``."""

    terms: tuple[Constraint, ...]

    def __init__(self, *terms: Constraint | Constraints) -> None:
        object.__setattr__(self, "terms", _flatten(terms, Constraint, "constraints", "ocp.inequality or ocp.equality"))

    def __add__(self, other: Constraint | Constraints) -> Constraints:
        return Constraints(self, other)

    def __iter__(self) -> Iterator[Constraint]:
        return iter(self.terms)


def _flatten(terms: tuple[object, ...], kind: type, where: str, advice: str) -> tuple[object, ...]:
    flat: list[object] = []
    for term in terms:
        if isinstance(term, Objective | Constraints) and all(isinstance(t, kind) for t in term):
            flat.extend(term)
        elif isinstance(term, kind):
            flat.append(term)
        else:
            hint = "give it a weight with .weighted(w)" if isinstance(term, Residual) else f"make it with {advice}"
            raise ProblemError(
                f"{where} ({caller()}): not a term - got {_brief(term)}, expected a {kind.__name__}; {hint}"
            )
    return tuple(flat)


def _brief(term: object) -> str:
    """Return a short description of an argument that is not the term that was expected."""
    if isinstance(term, Term):
        return f"the {getattr(term, 'kind', 'cost')} '{term.name}' ({term.source})"
    if isinstance(term, Residual):
        return f"a residual ({term.source})"
    return brief(term)
