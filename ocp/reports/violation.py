"""Violations: by how much a named row is missed, and what may be missed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["defect", "equality", "inequality"]

BOUNDS: dict[Kind, float] = {"defect": 1e-4, "equality": 1e-3, "inequality": 1e-3}
"""What a solution may miss: defects in the tangent's units, rows in raw SI over their scale."""


@dataclass(frozen=True)
class Violation:
    """By how much one named row is missed, at its worst node.

    Args:
        name: term, component and side; for a defect the component of the state.
        phase: name of the phase.
        node: node in the phase; a phase's defect 0 is that of the initial state or of the reset map before it.
        amount: raw SI amount divided by the row's scale, 0 if the row holds; not finite counts as infinite.
        unit: unit of the raw amount.
        kind: what kind of row.
        source: where the term was declared.
        multiplier: the force with which a constraint acts there; None where no solve has found one.
    """

    name: str
    phase: str
    node: int
    amount: float
    unit: str
    kind: Kind
    source: str = ""
    multiplier: float | None = None

    @property
    def ratio(self) -> float:
        """The amount relative to what ``BOUNDS`` allows."""
        return self.amount / BOUNDS[self.kind]
