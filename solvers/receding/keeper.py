"""Arrays and structures in memory that C refers to, kept as long as their owner."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from piaffe.codegen import aligned_zeros


class Keeper:
    """Keeps what C has the addresses of; an empty array has an address, too."""

    def __init__(self) -> None:
        self._kept: list[Any] = []
        self.vectors: dict[int, int] = {}
        """Number of vectors at an address, for memory whose size depends on the width of a vector."""

    def keep(self, thing: Any) -> Any:
        """Return a thing, which now lives as long as this."""
        self._kept.append(thing)
        return thing

    def doubles(self, values: ArrayLike) -> int:
        """Return the address of a copy of numbers, row by row, aligned for vectors."""
        flat = np.ravel(np.asarray(values, dtype=float))
        array = aligned_zeros(max(flat.size, 1))
        array[: flat.size] = flat
        return int(self.keep(array).ctypes.data)

    def zeros(self, count: int) -> int:
        """Return the address of zeros."""
        return int(self.keep(aligned_zeros(max(count, 1))).ctypes.data)

    def zero_vectors(self, count: int, width: int) -> int:
        """Return the address of vectors of zeros, each of ``width`` doubles."""
        address = self.zeros(count * width)
        self.vectors[address] = max(count, 1)
        return address

    def ints(self, values: ArrayLike) -> int:
        """Return the address of a copy of whole numbers as C's int."""
        flat = np.ravel(np.asarray(values)).astype(np.int32)
        return int(self.keep(flat if flat.size else np.zeros(1, dtype=np.int32)).ctypes.data)

    def array(self, kind: Any, values: Sequence[Any]) -> int:
        """Return the address of an array of structures."""
        return ct.addressof(self.keep((kind * max(len(values), 1))(*values)))
