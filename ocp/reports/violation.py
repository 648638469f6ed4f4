"""Violations of named rows, and the largest violations that a verified solution may have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Kind = Literal["defect", "equality", "inequality", "slip", "height", "flight"]

BOUNDS: dict[Kind, float] = {
    "defect": 1e-4, "equality": 1e-3, "inequality": 1e-3, "slip": 1e-3, "height": 1e-3, "flight": 12e-3,
}  # fmt: skip
"""Largest violations of a verified solution: defects in the tangent's units, rows in SI units over their scale; slip
and height of resting feet and the distance of the centre of mass from its parabola in flight [m]."""


@dataclass(frozen=True)
class Violation:
    """The violation of one named row at its worst node.

    Args:
        name: term, component and side; for a defect the component of the state; for slip, height and flight the foot
            or the point.
        phase: name of the phase.
        node: node in the phase; a phase's defect 0 is that of the initial state or of the reset map before it.
        amount: violation in SI units divided by the row's scale; 0 if the row holds, infinite if it is not finite.
        unit: unit of the violation before the division.
        kind: kind of the row.
        source: where the term was declared.
        multiplier: the constraint's multiplier there; None if it does not come from a solve.
        term: name of the constraint.
        scale: scale of the row, in its unit.
        push: sum of the constraint's multipliers over its rows and nodes (times the time step where they are per time):
            by how much the cost falls if its bounds move by one scale.
        conflict: the same sum of multipliers times violations.
        size: largest absolute value of its rows, divided by the scale.
    """

    name: str
    phase: str
    node: int
    amount: float
    unit: str
    kind: Kind
    source: str = ""
    multiplier: float | None = None
    term: str = ""
    scale: float = 1.0
    push: float = 0.0
    conflict: float = 0.0
    size: float = 0.0

    @property
    def ratio(self) -> float:
        """The amount relative to the bound in ``BOUNDS``."""
        return self.amount / BOUNDS[self.kind]


def finite(amount: float) -> float:
    """Return an amount, infinite if it is not a finite number: NaN would compare as no violation."""
    return float(amount) if np.isfinite(amount) else float("inf")
