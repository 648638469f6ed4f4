"""Evaluation of a CasADi function at many nodes at once, with NumPy arrays."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BLOCK = 8  # nodes per call of CasADi; a map for each number of nodes would take longer to build than to evaluate


class Vectorised:
    """A CasADi function, evaluated at n nodes.

    Outputs named ``K`` or ending in ``_w``, ``_z``, ``_x`` are matrices, (n, rows, cols); all others are columns,
    (n, rows).

    Args:
        function: a function of dense columns.
    """

    def __init__(self, function: cs.Function) -> None:
        self.function = function
        self._inputs = [function.size1_in(i) for i in range(function.n_in())]
        self.names = [function.name_out(i) for i in range(function.n_out())]
        self._outputs = {name: _Output(name, function.sparsity_out(i)) for i, name in enumerate(self.names)}
        self._calls: dict[int, tuple[Any, Any]] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_calls": {}}  # calls refer to memory of this process

    def __call__(self, *arguments: Array) -> list[Array]:
        """Evaluate; arguments are (n, size), results (n, rows, cols) for matrices and (n, rows) for columns."""
        return [self.filled(name, values) for name, values in zip(self.names, self.nonzeros(*arguments), strict=True)]

    def nonzeros(self, *arguments: Array) -> list[Array]:
        """Evaluate; results are the structural nonzeros of each output, (n, nnz), column by column."""
        n = len(arguments[0])
        results = [np.empty((n, output.nnz)) for output in self._outputs.values()]
        if n:
            contiguous = [np.ascontiguousarray(a, dtype=float).reshape(-1) for a in arguments]
            for i, (argument, size) in enumerate(zip(contiguous, self._inputs, strict=True)):
                if argument.size != n * size:
                    name = self.function.name_in(i)
                    raise ValueError(
                        f"function '{self.function.name()}', input '{name}': got {argument.size}, expected {n} x {size}"
                    )
            ends = [*range(0, n - n % _BLOCK, _BLOCK), *range(n - n % _BLOCK, n + 1)]  # blocks, then one by one
            self._run(list(pairwise(ends)), contiguous, results)
        return results

    def filled(self, name: str, nonzeros: Array) -> Array:
        """Return an output with its zeros: (n, rows, cols) for a matrix, (n, rows) for a column."""
        return self._outputs[name].filled(nonzeros)

    def _run(self, spans: Sequence[tuple[int, int]], contiguous: Sequence[Array], results: Sequence[Array]) -> None:
        inputs = [(i, size, a.data) for i, (a, size) in enumerate(zip(contiguous, self._inputs, strict=True)) if size]
        outputs = [(i, r.shape[1], r.reshape(-1).data) for i, r in enumerate(results) if r.shape[1]]
        for start, end in spans:
            buffer, run = self._call(end - start)
            for i, size, view in inputs:
                buffer.set_arg(i, view[start * size : end * size])
            for i, size, view in outputs:
                buffer.set_res(i, view[start * size : end * size])
            run()

    def _call(self, count: int) -> tuple[Any, Any]:
        """Return the buffer and the call of the function for a number of nodes."""
        if count not in self._calls:
            buffer: Any
            buffer, run = _mapped(self.function, count).buffer()
            for i, size in enumerate(self._inputs):
                if not size:
                    buffer.set_arg(i, _NOTHING.data)
            for i, output in enumerate(self._outputs.values()):
                if not output.nnz:
                    buffer.set_res(i, _NOTHING.data)
            self._calls[count] = buffer, run
        return self._calls[count]


class _Output:
    """The shape of an output and the positions of its nonzeros."""

    def __init__(self, name: str, sparsity: cs.Sparsity) -> None:
        self.rows, self.cols = sparsity.shape
        self.nnz = sparsity.nnz()
        self.is_matrix = name == "K" or name[-2:] in ("_w", "_z", "_x")
        self._places = None if sparsity.is_dense() else np.array(sparsity.find(), dtype=int)

    def filled(self, nonzeros: Array) -> Array:
        """Return the output with its zeros, from its nonzeros (n, nnz)."""
        n = len(nonzeros)
        if self._places is not None:
            dense = np.zeros((n, self.rows * self.cols))
            dense[:, self._places] = nonzeros
            nonzeros = dense
        return nonzeros.reshape(n, self.cols, self.rows).swapaxes(1, 2) if self.is_matrix else nonzeros


@lru_cache(maxsize=1024)
def _mapped(function: cs.Function, n: int) -> cs.Function:
    return function.map(n) if n > 1 else function


_NOTHING = np.zeros(1)
