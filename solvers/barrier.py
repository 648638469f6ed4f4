"""The relaxed logarithmic barrier of inequalities g ≥ 0, per row.

    β(g) = −ln g                                  for g > δ
         = ½ [((g − 2δ)/δ)² − 1] − ln δ           otherwise

It enters the cost as ε β. At a row with multiplier λ the minimiser has g ≥ 0 if and only if δ ≤ 2 ε/λ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def value(g: Array, relaxation: Array) -> Array:
    """Return β(g; δ), elementwise."""
    inside = g > relaxation
    safe = np.where(inside, g, relaxation)
    quadratic = 0.5 * (((g - 2 * relaxation) / relaxation) ** 2 - 1) - np.log(relaxation)
    return np.where(inside, -np.log(safe), quadratic)


def slope(g: Array, relaxation: Array) -> Array:
    """Return β'(g; δ), elementwise; negative."""
    inside = g > relaxation
    safe = np.where(inside, g, relaxation)
    return np.where(inside, -1 / safe, (g - 2 * relaxation) / relaxation**2)


def curvature(g: Array, relaxation: Array) -> Array:
    """Return β''(g; δ), elementwise; positive."""
    return 1 / np.maximum(g, relaxation) ** 2


def shrink(relaxation: Array, g: Array, mask: Array, slack: float, factor: float, floor: float) -> Array:
    """Return smaller relaxations for the rows that are violated by more than ``slack``.

    A row in the quadratic part pushes with λ = ε (2δ − g)/δ²; to push as hard at g = 0 it needs δ' = 2 ε/λ =
    2 δ²/(2δ − g). Rows that are met, or nearly, keep theirs: a foot that has just left the ground has g = 0 by
    geometry, and no relaxation could change that.
    """
    needed = 2 * relaxation**2 / np.maximum(2 * relaxation - g, relaxation)
    violated = (g < -slack) & (mask > 0)
    return np.where(violated, np.clip(factor * needed, floor, relaxation), relaxation)
