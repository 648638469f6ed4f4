"""The dual active-set method in C: its memory is allocated once for each size of program."""

from __future__ import annotations

import ctypes as ct
import warnings
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import NoCompilerWarning, c_library, pointer

from .result import QpResult, QpStatus

Array = NDArray[np.float64]

_STATUS = tuple(QpStatus)  # in the order of the enumeration in dual.c


@lru_cache(maxsize=1)
def qp_library() -> ct.CDLL | None:
    """Return the compiled method; None, with a warning, if no compiler works."""
    loaded = c_library("piaffe.solvers.qp", "dual", "quadratic programs")
    if loaded is None:
        warnings.warn("solving in NumPy: quadratic programs need a C compiler", NoCompilerWarning, stacklevel=3)
        return None
    loaded.piaffe_qp.restype = ct.c_int
    return loaded


class QpMemory:
    """The numbers of a program of n variables, m equality rows and k inequality rows, and the memory to solve it.

    The arrays ``H`` (n, n), ``g``, ``A`` (m, n), ``b``, ``C`` (k, n) and ``d`` are written before :meth:`solve`.

    Args:
        n: variables. m: equality rows. k: inequality rows.
        library: the compiled method.
    """

    def __init__(self, n: int, m: int, k: int, library: ct.CDLL) -> None:
        self.sizes = n, m, k
        self.H, self.g = np.zeros((n, n)), np.zeros(n)
        self.A, self.b, self.C, self.d = np.zeros((m, n)), np.zeros(m), np.zeros((k, n)), np.zeros(k)
        self._x, self._multipliers, self._active = np.zeros(n), np.zeros(m + k), np.zeros(k, dtype=np.int32)
        self._counts, self._work = np.zeros(2, dtype=np.int32), np.zeros(n * (2 * n + 5) + 3 * (m + k))
        self._places = np.zeros(n + m + 2 * k, dtype=np.int32)
        arrays = (
            self.H, self.g, self.A, self.b, self.C, self.d, self._x, self._multipliers, self._active, self._counts,
            self._work, self._places,
        )  # fmt: skip
        self._call, self._arguments = library.piaffe_qp, (n, m, k, *(pointer(array) for array in arrays))

    def solve(self, first: NDArray[np.bool_] | None = None) -> QpResult:
        """Solve the program, see :func:`piaffe.solvers.solve_qp`."""
        m = self.sizes[1]
        self._active[:] = 0 if first is None else first
        status = _STATUS[self._call(*self._arguments)]
        x = self._x.copy() if status is QpStatus.SOLVED else np.full(self.sizes[0], np.nan)
        return QpResult(
            status, x, self._multipliers[:m].copy(), self._multipliers[m:].copy(), self._active != 0,
            int(self._counts[0]),
        )  # fmt: skip


def solve_compiled(
    library: ct.CDLL, H: Array, g: Array, A: Array, b: Array, C: Array, d: Array, first: NDArray[np.bool_] | None
) -> QpResult:
    """Copy a program into memory of its own, and solve it."""
    memory = QpMemory(len(g), len(b), len(d), library)
    memory.H[:], memory.g[:], memory.A[:], memory.b[:], memory.C[:], memory.d[:] = H, g, A, b, C, d
    return memory.solve(first)
