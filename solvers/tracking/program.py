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

    Attributes:
        H: (nu, nu).
        g: (nu,).
        A: (m, nu).
        b: (m,).
        C: (k, nu).
        d: (k,).
        rows: index of each inequality among the rows of the mode, (k,).
    """

    H: Array
    g: Array
    A: Array
    b: Array
    C: Array
    d: Array
    rows: NDArray[np.int_]


@dataclass(frozen=True)
class VwbcTick:
    """What the last tick did.

    Args:
        status: of the quadratic program; None if the state was not finite.
        iterations: of the quadratic program.
        active: names of the inequality rows that hold as equalities.
    """

    status: QpStatus | None
    iterations: int
    active: tuple[str, ...]
