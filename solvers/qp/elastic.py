"""A quadratic program whose soft rows give way if no point meets all rows: the readable twin of ``elastic.inc``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .result import QpResult, QpStatus

Array = NDArray[np.float64]
Method = Callable[[Array, Array, Array, Array, Array, Array, NDArray[np.bool_] | None], QpResult]

_WEIGHT = 1e2  # w, in mean diagonal entries of H
_CURVATURE = 1e-3  # c, the same; it makes the program strictly convex


def solve_elastic(
    method: Method,
    H: Array,
    g: Array,
    A: Array,
    b: Array,
    C: Array,
    d: Array,
    soft: NDArray[np.bool_],
    first: NDArray[np.bool_] | None = None,
) -> QpResult:
    """Return the minimum of a program, or of the program whose soft rows are looser by their least common excess.

    If no point meets all rows, the second program is::

        minimise ½ xᵀH x + gᵀx + w s + ½ c s²   subject to   A x = b,   C x + soft s ≥ d,   s ≥ 0

    The excess s is the least possible, unless the multipliers of the soft rows, at this excess, would sum to more than
    its price w, 100 mean diagonal entries of H; then rows give way until they do not.

    Args:
        method: of both programs.
        H: (n, n), positive definite.
        g: (n,).
        A: (m, n).
        b: (m,).
        C: (k, n).
        d: (k,).
        soft: rows of C that may give way (k,).
        first: rows of C that are tried first (k,).
    """
    result = method(H, g, A, b, C, d, first)
    if result.status is not QpStatus.INFEASIBLE or not soft.any():
        return result
    n, m, k = len(g), len(b), len(d)
    mean = np.trace(H) / n
    larger = np.zeros((n + 1, n + 1))
    larger[:n, :n], larger[n, n] = H, _CURVATURE * mean
    rows = np.block([[C, soft[:, None].astype(float)], [np.zeros((1, n)), np.ones((1, 1))]])
    second = method(
        larger, np.append(g, _WEIGHT * mean), np.hstack([A, np.zeros((m, 1))]), b, rows, np.append(d, 0.0), None
    )
    iterations = result.iterations + second.iterations
    if second.status is not QpStatus.SOLVED:
        return replace(result, iterations=iterations)
    return QpResult(
        QpStatus.RELAXED, second.x[:n], second.equality, second.inequality[:k], second.active[:k], iterations,
        excess=float(second.x[n]),
    )  # fmt: skip
