"""A dual active-set method for small quadratic programs, in NumPy: the readable twin of ``template/dual.c``.

After [Goldfarb1983Dual]. Here a step is a least-squares problem; the C code updates its factors instead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .result import LIMIT, QpResult, QpStatus

Array = NDArray[np.float64]

_TOLERANCE = 1e-9  # of a row's distance, relative to the numbers in it
_DEPENDENT = 1e-20  # squared sine below which a row depends on the active ones
_SMALL = 1e-14  # a row's share of the step below which its multiplier does not change


def solve_dual(
    H: Array, g: Array, A: Array, b: Array, C: Array, d: Array, first: NDArray[np.bool_] | None = None
) -> QpResult:
    """Return the minimum of ½ xᵀH x + gᵀx subject to A x = b and C x ≥ d.

    Args:
        H: (n, n), positive definite.
        g: (n,).
        A: (m, n).
        b: (m,).
        C: (k, n).
        d: (k,); −inf is no row.
        first: rows of C that are added first if they are violated, (k,); by default the most violated row is.
    """
    m, k, n = len(b), len(d), len(g)
    rows, levels = np.vstack([A, C]), np.concatenate([b, d])
    preferred = np.zeros(k, dtype=bool) if first is None else np.asarray(first, dtype=bool)

    def ended(status: QpStatus, count: int = 0) -> QpResult:
        return QpResult(status, np.full(n, np.nan), np.zeros(m), np.zeros(k), np.zeros(k, dtype=bool), count)

    if not (np.isfinite(H).all() and np.isfinite(g).all() and np.isfinite(rows).all() and np.isfinite(b).all()):
        return ended(QpStatus.NOT_FINITE)
    if np.isnan(d).any() or np.isposinf(d).any():
        return ended(QpStatus.NOT_FINITE)
    try:
        H = np.tril(H) + np.tril(H, -1).T
        to_white = np.linalg.inv(np.linalg.cholesky(H))  # L⁻¹: in w = Lᵀx the objective is ½|w|² + ...
    except np.linalg.LinAlgError:
        return ended(QpStatus.NOT_CONVEX)
    norms = np.linalg.norm(rows, axis=1)
    norms[norms == 0] = 1.0
    rows, levels = rows / norms[:, None], levels / norms
    white = rows @ to_white.T
    x = -to_white.T @ (to_white @ g)
    active: list[int] = []
    u: list[float] = []
    count, equalities_left = 0, list(range(m))

    while True:
        slack = rows @ x - levels
        allowed = _TOLERANCE * (1 + np.abs(x).max(initial=0.0) + np.abs(levels))
        if equalities_left:
            p = equalities_left.pop(0)
        else:
            violated = [i for i in range(m, m + k) if i not in active and slack[i] < -allowed[i]]
            if not violated:
                break
            p = min(violated, key=lambda i: (not preferred[i - m], slack[i]))
        added, missing = 0.0, slack[p]
        while True:
            count += 1
            if count > LIMIT:
                return ended(QpStatus.ITERATION_LIMIT, LIMIT)
            Q, R = np.linalg.qr(white[active].T)
            r = np.linalg.solve(R, Q.T @ white[p])
            across = white[p] - Q @ (Q.T @ white[p])
            across -= Q @ (Q.T @ across)
            free, z = across @ across, to_white.T @ across
            most = max((abs(r[i]) for i, row in enumerate(active) if row >= m), default=0.0)
            falling = [i for i, row in enumerate(active) if row >= m and r[i] > _SMALL * most]
            drop = min(falling, key=lambda i: u[i] / r[i], default=None)
            to_drop = np.inf if drop is None else u[drop] / r[drop]
            independent = free > _DEPENDENT * (white[p] @ white[p])
            to_add = -missing / free if independent else np.inf
            step = min(to_add, to_drop)
            if step == np.inf:
                if p < m and abs(missing) <= allowed[p]:
                    break  # an equality that follows from the others has no effect
                return ended(QpStatus.INFEASIBLE, count)
            u = [value - step * share for value, share in zip(u, r, strict=True)]
            added += step
            if independent:
                x, missing = x + step * z, missing + step * free
            if step == to_add:
                active.append(p)
                u.append(added)
                break
            assert drop is not None  # else the step were infinite
            del active[drop], u[drop]

    N, q = rows[active].T, len(active)  # one step of Newton's method on the active rows removes rounding errors
    multipliers = np.array(u)
    system = np.block([[H, -N], [N.T, np.zeros((q, q))]])
    error = np.concatenate([-(H @ x + g - N @ multipliers), levels[active] - N.T @ x])
    change = np.linalg.solve(system, error)
    x, multipliers = x + change[:n], multipliers + change[n:]
    every = np.zeros(m + k)
    every[active] = multipliers / norms[active]
    chosen = np.isin(np.arange(m, m + k), active)
    return QpResult(QpStatus.SOLVED, x, every[:m], np.maximum(every[m:], 0.0), chosen, count)
