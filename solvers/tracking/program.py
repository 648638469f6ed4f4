"""The quadratic program of a tick, and what became of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..qp import QpStatus

Array = NDArray[np.float64]


class Program(NamedTuple):
    """The quadratic program of a tick, in δu: minimise ½ δuᵀH δu + gᵀδu subject to A δu = b, C δu ≥ d.

    If no δu meets all rows, the soft ones give way by their least common excess.

    Attributes:
        H: (nu, nu).
        g: (nu,).
        A: (m, nu).
        b: (m,).
        C: (k, nu).
        d: (k,).
        rows: index of each inequality among the rows of the mode, (k,).
        soft: inequalities that give way if no δu meets all rows, (k,).
    """

    H: Array
    g: Array
    A: Array
    b: Array
    C: Array
    d: Array
    rows: NDArray[np.int_]
    soft: NDArray[np.bool_]


@dataclass(frozen=True)
class VwbcTick:
    """What the last tick did.

    Args:
        status: of the quadratic program; None if the state was not finite.
        iterations: of the quadratic program.
        active: names of the inequality rows that hold as equalities.
        excess: by how much the limits on contact forces gave way, in units of the rows' scales.
    """

    status: QpStatus | None
    iterations: int
    active: tuple[str, ...]
    excess: float = 0.0
