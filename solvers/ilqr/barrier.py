"""The relaxed logarithmic barrier of inequalities g ≥ 0, per row.

    β(g) = −ln g                                  for g > δ
         = ½ [((g − 2δ)/δ)² − 1] − ln δ           otherwise

The cost contains ε β(g − s). At a row with multiplier λ and shift s = 0, the minimiser has g ≥ 0 if and only if
δ ≤ 2 ε/λ. A shift s > 0 allows a larger multiplier.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .. import constants

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


def shrink(relaxation: Array, g: Array, mask: Array, slack: float, floor: float) -> Array:
    """Return smaller relaxations for the rows that are violated by more than ``slack``, none below ``floor``.

    A row in the quadratic part has the multiplier λ = ε (2δ − g)/δ². The same multiplier at g = 0 needs δ' = 2 ε/λ =
    2 δ²/(2δ − g). The reduction is limited on both sides, because the multiplier is only an estimate.
    """
    needed = 2 * relaxation**2 / np.maximum(2 * relaxation - g, relaxation)
    needed = np.clip(needed, relaxation / constants.LARGEST_SHRINK, constants.LEAST_SHRINK * relaxation)
    violated = (g < -slack) & (mask > 0)
    return np.where(violated, np.clip(needed, np.minimum(floor, relaxation), relaxation), relaxation)


def follow(relaxation: Array, g: Array, shift: Array, mask: Array, drop: float, floor: float) -> Array:
    """Return relaxations after a decrease of ε by the factor ``drop``: active rows keep their multiplier at the bound.

    A row in the quadratic part is active. At g = 0 its multiplier is 2 ε/δ, so δ decreases as ε does, not below
    ``floor``. Otherwise each decrease of ε would let all active rows violate their bounds until δ shrinks again.
    """
    active = (g - shift < relaxation) & (mask > 0)
    return np.where(active, np.minimum(relaxation, np.maximum(relaxation * drop, floor)), relaxation)


def recentre(shift: Array, g: Array, mask: Array, slack: float) -> Array:
    """Return shifts s' with which the barrier has the present multiplier at g = 0: s' = max(0, s − g).

    This is the multiplier update of an augmented Lagrangian. It is used where a smaller δ would make the problem too
    stiff: for rows whose multiplier λ exceeds 2 ε/δ at the smallest δ.
    """
    shifted = ((g < -slack) | (shift > 0)) & (mask > 0)
    return np.where(shifted, np.maximum(shift - g, 0.0), shift)


def stiffen(relaxation: Array, shift: Array, used: NDArray[np.bool_], floor: float) -> tuple[Array, Array]:
    """Return relaxations δ' and shifts s' of stiffer rows that have the same multiplier at g = 0.

    At g = 0 it is ε (2δ + s)/δ². Without a shift, δ' = 2δ²/(2δ + s); δ' is not below ``floor``, and s' is the rest.

    Args:
        relaxation: δ.
        shift: s.
        used: which rows become stiffer.
        floor: smallest relaxation.
    """
    needed = 2 * relaxation + shift
    stiffer = np.minimum(np.maximum(floor, 2 * relaxation**2 / needed), relaxation)
    rest = np.maximum(needed * (stiffer / relaxation) ** 2 - 2 * stiffer, 0.0)
    return np.where(used, stiffer, relaxation), np.where(used, rest, shift)
