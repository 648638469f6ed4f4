"""Other values of a model's slots in the low level, as places in the parameter vector."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ShapeError, SolverError, UnknownNameError
from piaffe.ocp import LoweredMode

Array = NDArray[np.float64]
Changes = Sequence[tuple[slice, Array]]


def slot_changes(mode: LoweredMode, slots: Mapping[str, ArrayLike]) -> list[tuple[slice, Array]]:
    """Return the places of slots in the parameter vector, and their values."""
    changes = []
    for name, given in slots.items():
        if name not in mode.layout.slots:
            raise UnknownNameError(f"vwbc, model '{mode.model.name}'", "slot", name, mode.layout.slots)
        where, value = mode.layout.slots[name], np.atleast_1d(np.asarray(given, dtype=float)).ravel()
        if value.size not in (1, where.stop - where.start):
            raise ShapeError(
                f"vwbc, model '{mode.model.name}', slot '{name}': wrong size - got {value.size} entries, expected "
                f"{where.stop - where.start}; fix it"
            )
        positive = any(key.positive for key in mode.layout.slices if key.kind == "slot" and key.name == name)
        if positive and np.any(value <= 0):
            raise SolverError(
                f"vwbc, model '{mode.model.name}', slot '{name}': is out of range - got {value.tolist()}, expected "
                "numbers > 0; fix it"
            )
        changes.append((where, value))
    return changes
