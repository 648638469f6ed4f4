"""The interface of an engine: one function of many samples at many steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import casadi as cs
import numpy as np

PER_SAMPLE = ("x", "u", "z")
"""Names of inputs that differ between samples; all other inputs only depend on the step."""


class BatchFunction(ABC):
    """A function y = f(x, u, z, p, ...) evaluated over n samples and S steps.

    Only one thread may call it at a time: except with JAX, the next call with the same numbers of samples and steps
    overwrites the results.

    Args:
        function: a function of dense columns with dense outputs.
        by_row: whether the rows of an output are the first axis, (m, n, S), or the last one, (n, S, m). With
            the native engine, the first axis is the outermost one in memory in both cases.
    """

    def __init__(self, function: cs.Function, *, by_row: bool) -> None:
        self.function, self.by_row = function, by_row
        self.inputs = tuple((name, function.size1_in(i)) for i, name in enumerate(function.name_in()))
        self.sizes = tuple(function.size1_out(i) for i in range(function.n_out()))

    @staticmethod
    def array(value: Any) -> Any:
        """Return a user's value as an array of this engine."""
        return np.asarray(value, dtype=float)

    @abstractmethod
    def __call__(self, arguments: Sequence[Any], n: int, steps: int) -> list[Any]:
        """Return the outputs.

        Args:
            arguments: in the function's order, (n, S, size) for x, u and z, (S, size) for others; any strides.
            n: number of samples.
            steps: S.
        """
