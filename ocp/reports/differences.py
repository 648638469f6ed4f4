"""Central differences of functions with several outputs, and their order of convergence to a derivative."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP = 1e-4  # relative to max(1, |value|); truncation and rounding are then both near 1e-8
COARSE = 40  # the order of convergence is measured with steps larger by this factor


@dataclass(frozen=True)
class Difference:
    """Central differences of one output, all (rows, directions).

    Args:
        full, half: at STEP and at half of it.
        coarse, coarse_half: the same at COARSE times the step.
        bend, bend_half: difference of the forward and the backward slope, at STEP and at half of it. For a smooth
            function it halves with the step; at a kink it does not.
        size: largest |value|, (rows,).
    """

    full: Array
    half: Array
    coarse: Array
    coarse_half: Array
    bend: Array
    bend_half: Array
    size: Array

    def part(self, rows: Sequence[int] | slice, columns: slice = slice(None)) -> Difference:
        """Return the differences of some rows by some directions."""
        full, half, coarse, coarse_half, bend, bend_half = (
            table[rows][:, columns]
            for table in (self.full, self.half, self.coarse, self.coarse_half, self.bend, self.bend_half)
        )
        return Difference(full, half, coarse, coarse_half, bend, bend_half, self.size[rows])

    def has_kink(self, tolerance: float) -> bool:
        """Return whether forward and backward slopes differ by more than a tolerance, and as much at half the step."""
        kinks = (self.bend_half > 0.8 * self.bend) & (self.bend_half > tolerance)
        return bool(np.any(kinks))


def differences_of(function: Callable[[Array], Sequence[Array]], scale: Array) -> list[Difference]:
    """Return central differences of every output along every direction, in steps relative to ``scale``."""
    n, out = len(scale), []
    lengths = STEP * np.array([1.0, 0.5, COARSE, 0.5 * COARSE])
    directions = np.diag(scale)
    steps = [sign * length * directions for length in lengths for sign in (1, -1)]
    for values in function(np.concatenate([*steps, np.zeros((1, n))])):
        forward, backward = np.moveaxis(values[:-1].reshape(4, 2, n, -1), 1, 0)
        span = lengths[:, None, None] * scale[:, None]
        with np.errstate(invalid="ignore"):  # values that are not finite give differences that are not finite
            full, half, coarse, coarse_half = ((forward - backward) / (2 * span)).swapaxes(1, 2)
            bend, bend_half = np.abs((forward + backward - 2 * values[-1]) / span)[:2].swapaxes(1, 2)
        size = np.max(np.abs(values), axis=0, initial=0.0)
        out.append(Difference(full, half, coarse, coarse_half, bend, bend_half, size))
    return out


def rate_of(J: Array, coarse: Array, finer: Array, rounding: float) -> float | None:
    """Return the order of convergence of differences to J; None if they are exact up to rounding."""
    far, near = (float(np.max(np.abs(D - J), initial=0.0)) for D in (coarse, finer))
    return float(np.log2(far / near)) if near > rounding / COARSE and far > 0 else None
