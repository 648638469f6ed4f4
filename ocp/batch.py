"""Evaluation of a CasADi function over many nodes at once, NumPy in and out."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Batch:
    """A CasADi function mapped over n nodes, with buffers kept per n.

    Outputs named ``K`` or ending in ``_w``, ``_z``, ``_x`` are matrices, (n, rows, cols); all others are columns,
    (n, rows).

    Args:
        function: a function of dense columns and dense outputs.
    """

    def __init__(self, function: cs.Function) -> None:
        self.function = function
        self._inputs = [function.size1_in(i) for i in range(function.n_in())]
        self._outputs = [function.size_out(i) for i in range(function.n_out())]
        names = [function.name_out(i) for i in range(function.n_out())]
        self._is_matrix = [name == "K" or name[-2:] in ("_w", "_z", "_x") for name in names]
        self._maps: dict[int, tuple[Any, Any]] = {}

    def __call__(self, *arguments: Array) -> list[Array]:
        """Evaluate; arguments are (n, size), results (n, rows, cols) for matrices and (n, rows) for columns."""
        n = len(arguments[0])
        results = [np.zeros((n, cols, rows)) for rows, cols in self._outputs]
        if n:
            if n not in self._maps:
                self._maps[n] = _mapped(self.function, n).buffer()
            buffer, run = self._maps[n]
            held = [np.ascontiguousarray(a, dtype=float).reshape(-1) for a in arguments]
            for i, (argument, size) in enumerate(zip(held, self._inputs, strict=True)):
                if argument.size != n * size:
                    name = self.function.name_in(i)
                    raise ValueError(
                        f"function '{self.function.name()}', input '{name}': got {argument.size}, expected {n} x {size}"
                    )
                buffer.set_arg(i, (argument if size else _NOTHING).data)
            flat = [r.reshape(-1) for r in results]
            for i, result in enumerate(flat):
                buffer.set_res(i, (result if result.size else _NOTHING.copy()).data)
            run()
        return [
            r.swapaxes(1, 2) if matrix else r.reshape(n, -1) for r, matrix in zip(results, self._is_matrix, strict=True)
        ]


@lru_cache(maxsize=1024)
def _mapped(function: cs.Function, n: int) -> cs.Function:
    return function.map(n) if n > 1 else function


_NOTHING = np.zeros(1)
