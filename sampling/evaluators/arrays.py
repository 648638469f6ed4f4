"""Functions on NumPy arrays: each operation on all samples at once. This engine needs no compiler."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from ..translate import NUMPY_ERF, instructions
from .batch_function import PER_SAMPLE, BatchFunction

Array = NDArray[np.float64]

_POINTS = 8192  # samples times steps per pass: the arrays of some operations fit in the processor's cache


class ArrayFunction(BatchFunction):
    """The instructions of a function on NumPy arrays."""

    def __init__(self, function: cs.Function, *, by_row: bool) -> None:
        super().__init__(function, by_row=by_row)
        self._program = instructions(function, np, NUMPY_ERF)

    def __call__(self, arguments: Sequence[Array], n: int, steps: int) -> list[Array]:
        """Return the outputs."""
        results = [np.empty((size, steps, n)) for size in self.sizes]
        share = max(1, _POINTS // max(steps, 1))
        for first in range(0, n, share):
            part = slice(first, first + share)
            columns: list[Any] = [
                np.ascontiguousarray(argument[part].transpose(2, 1, 0)) if name in PER_SAMPLE else argument.T[..., None]
                for (name, _), argument in zip(self.inputs, arguments, strict=True)
            ]
            with np.errstate(all="ignore"):  # both sides of a selection are evaluated
                rows = self._program.columns(*columns)
            for result, output in zip(results, rows, strict=True):
                for row, value in zip(result, output, strict=True):
                    row[:, part] = value
        order = (0, 2, 1) if self.by_row else (2, 1, 0)
        return [result.transpose(order) for result in results]
