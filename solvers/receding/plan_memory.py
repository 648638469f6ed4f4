"""The memory of plans in C: it is used again once nothing refers to a plan or to an array of it."""

from __future__ import annotations

import ctypes as ct
import sys
import weakref

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import aligned_zeros

from ..tracking import PHASE_BYTES, PlanStruct
from . import structs as s

Array = NDArray[np.float64]

HEADER, PART, NUM_FIGURES = 7, 31, 16
"""Entries of a plan's header, entries per part, and figures; as in ``receding.h``."""


class PlanMemory:
    """The memory of one plan.

    Args:
        entries: of the header.
        numbers: number of doubles.
    """

    def __init__(self, entries: int, numbers: int) -> None:
        self.header: NDArray[np.int64] = np.zeros(entries, dtype=np.int64)
        self.numbers: Array = aligned_zeros(numbers)
        self._phases = np.zeros(PHASE_BYTES * ((entries - HEADER) // PART), dtype=np.uint8)
        self._view = PlanStruct()
        self.address = ct.addressof(self._view)
        """Where low levels read the plan."""
        self.c = s.Plan(self.header.ctypes.data, self.numbers.ctypes.data, self._phases.ctypes.data, self.address)
        self._references = sys.getrefcount(self.numbers.base)

    def view(self, first: int, shape: tuple[int, ...]) -> Array:
        """Return numbers from a place on, as an array that is not a copy."""
        return self.numbers[first : first + int(np.prod(shape))].reshape(shape)

    @property
    def is_free(self) -> bool:
        """Whether no array is a view of the numbers; views refer to the array that owns them."""
        return sys.getrefcount(self.numbers.base) <= self._references


class PlanPool:
    """Memories of plans that may be used again.

    A memory returns when its plan is gone. It is given out when no array of the plan is left either.
    """

    def __init__(self) -> None:
        self._returned: list[PlanMemory] = []

    def take(self) -> PlanMemory | None:
        """Return a memory that nothing refers to; None if there is none."""
        for memory in self._returned:
            if memory.is_free:
                self._returned.remove(memory)
                return memory
        return None

    def give(self, memory: PlanMemory) -> None:
        """Return a memory at once."""
        self._returned.append(memory)

    def follow(self, parts: object, memory: PlanMemory) -> None:
        """Let a memory return when the parts of its plan are gone."""
        weakref.finalize(parts, self._returned.append, memory)

    def __len__(self) -> int:
        return len(self._returned)
