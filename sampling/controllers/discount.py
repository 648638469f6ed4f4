"""Constraint discounting: violations reduce the weights of later rewards in a roll-out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import UnknownNameError

from ..namespace import namespace
from ..options import Options
from . import reduce
from .stage import Memory

Array = NDArray[np.float64]

_P_MAX = 0.25  # of constraints that a mapping does not name


@dataclass(frozen=True, eq=False)
class ConstraintDiscount:
    """δ = max_i p_i clip(c_i / c_i^max, 0, 1) of violations c_i ≥ 0, with moving maxima [TD-CD-MPPI, eq. 7 and 8].

    The maximum of each row is updated by that of each batch, ``c_max ← τ ĉ + (1 − τ) c_max``; the first batch sets it.
    It is at least ``floor``: without this limit, very small violations would get the full discount, too.

    The memory contains ``maxima``, (nc,), and ``batches``, the number of batches so far.

    Args:
        p_max: largest discount of each row, (nc,).
        rate: τ.
        floor: lower limit of the maxima.
    """

    p_max: Array
    rate: float
    floor: float

    @classmethod
    def of(cls, constraints: Sequence[str], options: Options) -> ConstraintDiscount:
        """Return the discount of rows.

        Args:
            constraints: name of the constraint of each row, (nc,).
            options: options; ``p_max``, ``violation_rate`` and ``violation_floor`` are used.

        Raises:
            UnknownNameError: ``p_max`` has the name of an unknown constraint.
        """
        return cls(_shares(constraints, options.p_max), options.violation_rate, options.violation_floor)

    def initial_memory(self) -> Memory:
        """Return the maxima before the first batch."""
        return {"maxima": np.zeros(len(self.p_max)), "batches": np.zeros(())}

    def maxima(self, memory: Memory) -> Any:
        """Return c_max of every row, (nc,)."""
        return namespace(memory["maxima"]).maximum(memory["maxima"], self.floor)

    def follow(self, memory: Memory, largest: Any) -> Memory:
        """Return the memory after an update by the maxima of a batch, (nc,)."""
        before, batches = memory["maxima"], memory["batches"]
        rate = namespace(largest).where(batches > 0, self.rate, 1.0)
        return {"maxima": before + rate * (largest - before), "batches": batches + 1}

    def delta(self, violation: Any, memory: Memory) -> Any:
        """Return δ of violations (nc, ...), with the shape of one row."""
        steps = violation if violation.ndim == 3 else violation.reshape(len(violation), 1, -1)
        return reduce.discount(steps, self.maxima(memory), self.p_max).reshape(violation.shape[1:])


def _shares(constraints: Sequence[str], p_max: float | Mapping[str, float]) -> Array:
    if not isinstance(p_max, Mapping):
        return np.full(len(constraints), float(p_max))
    for name in p_max:
        if name not in constraints:
            raise UnknownNameError("sampling options, p_max", "constraint", name, dict.fromkeys(constraints))
    return np.array([float(p_max.get(name, _P_MAX)) for name in constraints])


def discounted_return(reward: Any, delta: Any, discount: float, value: Any = None) -> Any:
    """Return Σ_h [Π_{k≤h} γ₀ (1 − δ_k)] r_h + [Π_{k≤H} γ₀ (1 − δ_k)] V(x_{H+1}), (n,) [TD-CD-MPPI, eq. 9 and 12].

    Args:
        reward: r_h (n, H + 1).
        delta: δ_h (n, H + 1).
        discount: γ₀.
        value: V at the last state, (n,); None for none.
    """
    xp = namespace(reward)
    weight = xp.cumprod(discount * (1.0 - delta), axis=1)
    total = xp.einsum("nh,nh->n", weight, reward)
    return total if value is None else total + weight[:, -1] * value
