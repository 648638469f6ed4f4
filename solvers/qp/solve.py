"""Solve a small quadratic program by the method of choice."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ShapeError, SolverError

from .compiled import qp_library, solve_compiled
from .dual import solve_dual
from .elastic import Method, solve_elastic
from .others import solve_daqp, solve_osqp
from .result import QpResult

Array = NDArray[np.float64]

QpMethod = Literal["own", "numpy", "daqp", "osqp"]
QP_METHODS: tuple[QpMethod, ...] = get_args(QpMethod)


def solve_qp(
    H: ArrayLike,
    g: ArrayLike,
    *,
    A: ArrayLike | None = None,
    b: ArrayLike | None = None,
    C: ArrayLike | None = None,
    d: ArrayLike | None = None,
    first: NDArray[np.bool_] | None = None,
    soft: NDArray[np.bool_] | None = None,
    method: QpMethod = "own",
) -> QpResult:
    """Return the minimum of a small, strictly convex quadratic program.

    The program is::

        minimise ½ xᵀH x + gᵀx   subject to   A x = b,   C x ≥ d

    The method ``"own"`` is the dual active-set method of Goldfarb and Idnani in C, for up to some tens of variables;
    without a compiler it is ``"numpy"``, the same in NumPy.

    Args:
        H: (n, n), positive definite; its lower triangle is read.
        g: (n,).
        A: (m, n); none by default.
        b: (m,).
        C: (k, n); none by default. Rows may be redundant, equal or zero.
        d: (k,); −inf is no row.
        first: rows of C that are tried first, for example the active rows of a similar program, (k,).
        soft: rows of C that may give way, all by the same least excess, if no point meets all rows, (k,); none by
            default.
        method: ``"own"``, ``"numpy"``, or ``"daqp"`` and ``"osqp"``, which ``piaffe[qp]`` installs.

    Returns:
        The result; its status says why it ended. A program without a solution does not raise.

    Raises:
        ShapeError: sizes do not fit.
        SolverError: the method is unknown, or not installed.
    """
    slope = np.asarray(g, dtype=float)
    n = slope.size
    rows = [np.zeros((0, n)) if part is None else np.asarray(part, dtype=float) for part in (A, C)]
    levels = [np.zeros(0) if part is None else np.asarray(part, dtype=float) for part in (b, d)]
    hessian = np.asarray(H, dtype=float)
    got = [hessian.shape, slope.shape, *(part.shape for pair in zip(rows, levels, strict=True) for part in pair)]
    expected = [(n, n), (n,), *(shape for level in levels for shape in ((level.size, n), (level.size,)))]
    if got != expected:
        raise ShapeError(
            f"quadratic program: sizes do not fit - got H, g, A, b, C, d of shapes {', '.join(map(str, got))}, "
            f"expected {', '.join(map(str, expected))}; fix them"
        )
    for name, flags in (("first", first), ("soft", soft)):
        if flags is not None and np.shape(flags) != levels[1].shape:
            raise ShapeError(
                f"quadratic program: '{name}' does not fit - got shape {np.shape(flags)}, expected {levels[1].shape}; "
                "give one flag for each row of C"
            )
    gives = np.zeros(levels[1].size, dtype=bool) if soft is None else np.asarray(soft, dtype=bool)
    program = hessian, slope, rows[0], levels[0], rows[1], levels[1]
    return solve_elastic(qp_method(method), *program, gives, first)


def qp_method(name: QpMethod) -> Method:
    """Return a method by name: a function of H, g, A, b, C, d and the rows that are tried first.

    Raises:
        SolverError: the method is unknown.
    """
    if name not in QP_METHODS:
        raise SolverError(
            f"quadratic program: method is unknown - got {name!r}, expected one of {', '.join(QP_METHODS)}; choose one"
        )
    others: Mapping[str, Method] = {"numpy": solve_dual, "daqp": solve_daqp, "osqp": solve_osqp}
    if name != "own":
        return others[name]
    library = qp_library()
    if library is None:
        return solve_dual
    loaded = library
    return lambda *program: solve_compiled(loaded, *program)
