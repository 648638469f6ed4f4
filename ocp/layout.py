"""Layouts: named slices of a flat vector of numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ShapeError

Array = NDArray[np.float64]


class Layout:
    """Names and sizes of the parts of a parameter vector ``p``.

    Args:
        parts: (name, size) in order.
    """

    def __init__(self, parts: Iterable[tuple[str, int]]) -> None:
        self.slices: dict[str, slice] = {}
        end = 0
        for name, size in parts:
            self.slices[name] = slice(end, end + size)
            end += size
        self.size = end

    def split(self, p: cs.SX) -> dict[str, cs.SX]:
        """Return the parts of a CasADi vector by name."""
        return {name: p[part] for name, part in self.slices.items()}

    def pack(self, values: Mapping[str, Array], count: int) -> Array:
        """Return (count, size) rows filled from values of shape (size,) or (count, size); all parts are required."""
        out = np.zeros((count, self.size))
        for name, part in self.slices.items():
            value = np.asarray(values[name], dtype=float)
            if value.shape[-1:] != (part.stop - part.start,):
                raise ShapeError(
                    f"parameter '{name}': wrong size - got {value.shape[-1:]}, expected {part.stop - part.start} "
                    "entries"
                )
            out[:, part] = value
        return out
