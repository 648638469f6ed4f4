"""Random quadratic programs of eight kinds, and how far a result is from the conditions of its minimum."""

from __future__ import annotations

import numpy as np

KINDS = (
    "feasible", "often infeasible", "degenerate", "equal rows", "zero rows", "redundant rows", "badly scaled",
    "dependent equalities",
)  # fmt: skip


def random_program(rng, i):
    """Return H, g, A, b, C, d of a program with 1 to 20 variables, of kind ``KINDS[i % 8]``."""
    kind = KINDS[i % 8]
    n = int(rng.integers(1, 21))
    m, k = int(rng.integers(0, min(n, 5) + 1)) if i % 3 else 0, int(rng.integers(0, 61))
    M = rng.standard_normal((n, n))
    H, g = M @ M.T + 10.0 ** rng.uniform(-3, 1) * np.eye(n), 3 * rng.standard_normal(n)
    A, C, x = rng.standard_normal((m, n)), rng.standard_normal((k, n)), rng.standard_normal(n)
    b, d = A @ x, C @ x - rng.uniform(0, 3) * rng.random(k)
    if kind == "often infeasible":
        d = d + rng.uniform(0, 4) * rng.random(k)
    elif kind == "degenerate":
        d = C @ x
    elif kind == "equal rows" and k > 1:
        chosen = rng.integers(0, k, k // 2)
        C[: k // 2], d[: k // 2] = C[chosen], d[chosen]
    elif kind == "zero rows" and k:
        C[rng.integers(0, k, 3)] = 0.0
        zero = np.all(C == 0, axis=1)
        d[zero] = rng.choice([-1.0, 0.0, -np.inf, 1.0], zero.sum(), p=[0.3, 0.4, 0.25, 0.05])
    elif kind == "redundant rows" and k > 2:
        share = rng.random((k // 3, k))
        C[: k // 3], d[: k // 3] = share @ C, share @ d - rng.choice([0.0, 0.1])
    elif kind == "badly scaled":
        each, row = 10.0 ** rng.uniform(-3, 3, n), 10.0 ** rng.uniform(-3, 3, k)
        H, g, A, C = H * each * each[:, None], g * each, A * each, C * each * row[:, None]
        d = d * row
    elif kind == "dependent equalities" and m > 1:
        A[-1], b[-1] = 2 * A[0], 2 * b[0] + (rng.random() < 0.2)
    return H, g, A, b, C, d


def distance_from_minimum(program, result):
    """Return the largest relative error in stationarity, rows, signs and complementarity."""
    H, g, A, b, C, d = program
    kept = np.isfinite(d)
    C, d, inequality = C[kept], d[kept], result.inequality[kept]
    norm = np.linalg.norm(C, axis=1)
    norm[norm == 0] = 1.0
    slack, inequality = (C @ result.x - d) / norm, inequality * norm
    size, force = 1 + np.abs(result.x).max(), 1 + np.abs(H @ result.x).max() + np.abs(g).max()
    gradient = H @ result.x + g - A.T @ result.equality - C.T @ (inequality / norm)
    near = size + np.abs(d / norm)
    return max(
        np.abs(gradient).max() / force,
        np.abs(A @ result.x - b).max(initial=0) / size,
        np.max(-slack / near, initial=0),
        np.max(-inequality, initial=0),
        np.abs(inequality * slack / near).max(initial=0) / force,
    )
