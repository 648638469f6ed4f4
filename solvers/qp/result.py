"""The result of a quadratic program."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIMIT = 200
"""Largest number of iterations: rows added plus rows dropped."""


class QpStatus(Enum):
    """Why the solution of a quadratic program ended."""

    SOLVED = "Solved: the minimum over all rows."
    INFEASIBLE = "No point meets all rows."
    NOT_CONVEX = "The Hessian is not positive definite."
    NOT_FINITE = "A number of the program is NaN or infinite."
    ITERATION_LIMIT = "Stopped at the iteration limit."
    RELAXED = "No point meets all rows; the soft rows gave way by their least common excess."


@dataclass(frozen=True, eq=False)
class QpResult:
    """The solution of a quadratic program.

    Args:
        status: why it ended; the other values have a meaning only with ``SOLVED`` and
            ``RELAXED``.
        x: the minimum (n,).
        equality: multipliers of the equality rows: H x + g = Aᵀ equality + Cᵀ inequality.
        inequality: multipliers of the inequality rows, at least 0.
        active: which inequality rows hold as equalities, by the method's last set.
        iterations: rows added plus rows dropped; of other methods, their own count.
        excess: by how much the soft rows gave way, in units of d; 0 if ``SOLVED``.
    """

    status: QpStatus
    x: Array
    equality: Array
    inequality: Array
    active: NDArray[np.bool_]
    iterations: int
    excess: float = 0.0
