"""The same programs with DAQP and OSQP, for comparison; the extra ``piaffe[qp]`` installs both."""

from __future__ import annotations

from contextlib import redirect_stdout
from importlib import import_module
from io import StringIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError

from .result import QpResult, QpStatus

Array = NDArray[np.float64]

_EQUALITY = 5  # DAQP's sense of a row that is active and stays so
_DAQP = {1: QpStatus.SOLVED, -1: QpStatus.INFEASIBLE, -4: QpStatus.ITERATION_LIMIT, -5: QpStatus.NOT_CONVEX}
_OSQP = {"solved": QpStatus.SOLVED, "primal infeasible": QpStatus.INFEASIBLE}


def _imported(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise SolverError(
            f"quadratic program: method '{name}' is not installed - got no module '{name}', expected it; install "
            "'piaffe[qp]', or use method='own'"
        ) from error


def solve_daqp(
    H: Array, g: Array, A: Array, b: Array, C: Array, d: Array, first: NDArray[np.bool_] | None = None
) -> QpResult:
    """Return the minimum by DAQP, from an empty active set."""
    daqp, m, kept = _imported("daqp"), len(b), np.isfinite(d)
    rows = np.ascontiguousarray(np.vstack([A, C[kept]]))
    lower, upper = np.concatenate([b, d[kept]]), np.concatenate([b, np.full(int(kept.sum()), 1e30)])
    sense = np.where(np.arange(len(lower)) < m, _EQUALITY, 0).astype(np.int32)
    x, _, flag, info = daqp.solve(H, g, rows, upper, lower, sense, primal_tol=1e-9)
    x, multipliers = np.array(x), -np.array(info["lam"])
    return _result(_DAQP.get(flag, QpStatus.ITERATION_LIMIT), x, multipliers, m, kept, int(info["iterations"]))


def solve_osqp(
    H: Array, g: Array, A: Array, b: Array, C: Array, d: Array, first: NDArray[np.bool_] | None = None
) -> QpResult:
    """Return the minimum by OSQP, from zero, with 4000 iterations and a polish."""
    osqp, sparse, m, kept = _imported("osqp"), _imported("scipy.sparse"), len(b), np.isfinite(d)
    lower, upper = np.concatenate([b, d[kept]]), np.concatenate([b, np.full(int(kept.sum()), np.inf)])
    solver = osqp.OSQP()
    solver.setup(
        sparse.csc_matrix(np.triu(H)), g, sparse.csc_matrix(np.vstack([A, C[kept]])), lower, upper, verbose=False,
        eps_abs=1e-6, eps_rel=1e-6, polishing=True,
    )  # fmt: skip
    with redirect_stdout(StringIO()):  # without active rows it prints that nothing is to be polished, verbose or not
        found = solver.solve(raise_error=False)
    status = _OSQP.get(str(found.info.status), QpStatus.ITERATION_LIMIT)
    return _result(status, np.array(found.x), -np.array(found.y), m, kept, int(found.info.iter))


def _result(
    status: QpStatus, x: Array, multipliers: Array, m: int, kept: NDArray[np.bool_], iterations: int
) -> QpResult:
    inequality = np.zeros(len(kept))
    inequality[kept] = np.maximum(multipliers[m:], 0.0)
    return QpResult(status, x, multipliers[:m], inequality, inequality > 0, iterations)
