"""Central differences of functions of many outputs, and the order at which they approach a derivative."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP = 1e-4  # relative to max(1, |value|); truncation and rounding are then both near 1e-8
COARSE = 40  # the rate of convergence is measured at this many times the step


@dataclass(frozen=True)
class Difference:
    """Central differences of one output, (rows, directions): at STEP, half of it, coarse ones; its size (rows,)."""

    full: Array
    half: Array
    coarse: Array
    coarse_half: Array
    size: Array


def differences_of(function: Callable[[Array], Sequence[Array]], scale: Array) -> list[Difference]:
    """Return central differences of every output along every direction, in steps relative to ``scale``."""
    n, out = len(scale), []
    lengths = STEP * np.array([1.0, 0.5, COARSE, 0.5 * COARSE])
    directions = np.diag(scale)
    steps = np.concatenate([sign * length * directions for length in lengths for sign in (1, -1)])
    for values in function(steps):
        table = values.reshape(4, 2, n, -1)
        slopes = (table[:, 0] - table[:, 1]) / (2 * lengths[:, None, None] * scale[:, None])
        full, half, coarse, coarse_half = (slope.T for slope in slopes)
        out.append(Difference(full, half, coarse, coarse_half, np.max(np.abs(table[:2]), axis=(0, 1, 2), initial=0.0)))
    return out


def rate_of(J: Array, coarse: Array, finer: Array, rounding: float) -> float | None:
    """Return the order at which differences approach J, None if they are exact to rounding."""
    far, near = (float(np.max(np.abs(D - J), initial=0.0)) for D in (coarse, finer))
    return float(np.log2(far / near)) if near > rounding / COARSE and far > 0 else None
