"""Constraint discounting: violations shorten how far ahead a roll-out collects reward."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import UnknownNameError

from ..options import Options
from . import reduce

Array = NDArray[np.float64]

_P_MAX = 0.25  # of constraints that a mapping does not name


class ConstraintDiscount:
    """δ = max_i p_i clip(c_i / c_i^max, 0, 1) of violations c_i ≥ 0, with moving maxima [TD-CD-MPPI, eq. 7 and 8].

    The maximum of each row follows that of the batch, ``c_max ← τ ĉ + (1 − τ) c_max``, and begins with the first
    batch. It is never below a floor: without one, the smaller the violations the more they would count.

    Args:
        constraints: name of the constraint that each row belongs to, (nc,).
        options: with ``p_max``, ``violation_rate`` and ``violation_floor``.
    """

    def __init__(self, constraints: Sequence[str], options: Options) -> None:
        self.p_max = _shares(constraints, options.p_max)
        self._rate, self._floor = options.violation_rate, options.violation_floor
        self.moving: Array | None = None

    @property
    def maxima(self) -> Array:
        """c_max of every row, (nc,)."""
        moving = np.zeros(len(self.p_max)) if self.moving is None else self.moving
        return np.maximum(moving, self._floor)

    def reset(self, maxima: Array | None = None) -> None:
        """Forget the maxima, or set them, (nc,)."""
        self.moving = None if maxima is None else np.array(maxima, dtype=float)

    def follow(self, largest: Array) -> None:
        """Let the maxima follow those of a batch, (nc,)."""
        if self.moving is None:
            self.moving = np.array(largest, dtype=float)
        else:
            self.moving += self._rate * (largest - self.moving)

    def of(self, violation: Array) -> Array:
        """Return δ of violations (nc, ...), of the shape of one row."""
        steps = violation if violation.ndim == 3 else violation.reshape(len(violation), 1, -1)
        return reduce.discount(steps, self.maxima, self.p_max).reshape(violation.shape[1:])


def _shares(constraints: Sequence[str], p_max: float | Mapping[str, float]) -> Array:
    if not isinstance(p_max, Mapping):
        return np.full(len(constraints), float(p_max))
    for name in p_max:
        if name not in constraints:
            raise UnknownNameError("sampling options, p_max", "constraint", name, dict.fromkeys(constraints))
    return np.array([float(p_max.get(name, _P_MAX)) for name in constraints])


def discounted_return(reward: Array, delta: Array, discount: float, value: Array | None = None) -> Array:
    """Return Σ_h [Π_{k≤h} γ₀ (1 − δ_k)] r_h + [Π_{k≤H} γ₀ (1 − δ_k)] V(x_{H+1}), (n,) [TD-CD-MPPI, eq. 9 and 12].

    Args:
        reward: r_h (n, H + 1).
        delta: δ_h (n, H + 1).
        discount: γ₀.
        value: V at the last state, (n,); None for none.
    """
    weight = np.cumprod(discount * (1.0 - delta), axis=1)
    total = np.einsum("nh,nh->n", weight, reward)
    return np.asarray(total if value is None else total + weight[:, -1] * value)
