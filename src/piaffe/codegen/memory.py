"""Memory for compiled functions: arrays at addresses that vectors may begin at; each thread's share of samples."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

Array = NDArray[np.float64]

ALIGNMENT = 64
"""Bytes of the widest vectors, and of a cache line."""

_DOUBLE = 8  # bytes
_LINE = ALIGNMENT // _DOUBLE  # doubles in a cache line
_CHUNK = 2**17  # doubles that are allocated at once, for many arrays


def aligned_zeros(count: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Return zeros, (count,), at an aligned address.

    Args:
        count: number of entries.
        dtype: their type.
    """
    size = np.dtype(dtype).itemsize
    raw = np.zeros(count * size + ALIGNMENT, dtype=np.uint8)
    first = -raw.ctypes.data % ALIGNMENT
    return raw[first : first + count * size].view(dtype)


class AlignedMemory:
    """Many aligned arrays of doubles, each part of a larger one; all live as long as this does.

    No two of them share a cache line.
    """

    def __init__(self) -> None:
        self._chunks: list[Array] = []
        self._free: Array = np.zeros(0)

    def zeros(self, size: int) -> Array:
        """Return zeros, (size,), at an aligned address."""
        if self._free.size < size:
            self._free = aligned_zeros(max(_CHUNK, size))
            self._chunks.append(self._free)
        array = self._free[:size]
        self._free = self._free[max(-(-size // _LINE), 1) * _LINE :]
        return array


def shares(count: int, width: int, threads: int) -> list[tuple[int, int]]:
    """Return first and last sample of each thread's share: whole blocks of lanes but for the last.

    Args:
        count: number of samples.
        width: lanes, samples per block.
        threads: number of threads.
    """
    blocks = -(-count // width)
    ends = [min(count, width * round(blocks * i / threads)) for i in range(threads + 1)]
    return list(pairwise(ends))
