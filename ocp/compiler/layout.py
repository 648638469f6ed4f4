"""Layouts: where the parameters are in a node's parameter vector ``p``."""

from __future__ import annotations

from collections.abc import Iterable

import casadi as cs

from ..language import TIME_STEP, ParameterKey


class Layout:
    """Keys and sizes of the parts of a parameter vector ``p``.

    Args:
        parts: (key, size) in order.

    Attributes:
        slices: where each parameter is.
        slots: where the slots of the model are, by their names.
        size: of the whole vector.
    """

    def __init__(self, parts: Iterable[tuple[ParameterKey, int]]) -> None:
        self.slices: dict[ParameterKey, slice] = {}
        end = 0
        for key, size in parts:
            self.slices[key] = slice(end, end + size)
            end += size
        self.slots = {key.name: part for key, part in self.slices.items() if key.kind == "slot"}
        self.size = end

    def of_model(self, p: cs.SX) -> dict[str, cs.SX]:
        """Return the parts of a CasADi vector that the model sees, by its own names: its slots and ``"dt"``."""
        return {**{name: p[part] for name, part in self.slots.items()}, "dt": p[self.slices[TIME_STEP]]}
