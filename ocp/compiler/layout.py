"""Layouts: the position of each parameter in a node's parameter vector ``p``."""

from __future__ import annotations

from collections.abc import Iterable

import casadi as cs

from ..language import TIME_STEP, ParameterKey


class Layout:
    """Keys and sizes of the parts of a parameter vector ``p``.

    Args:
        parts: (key, size) in order.

    Attributes:
        slices: the slice of each parameter.
        slots: the slices of the model's slots, by their names.
        size: size of the whole vector.
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
        """Return the parts of a CasADi vector that the model uses, by its own names: its slots and ``"dt"``."""
        return {**{name: p[part] for name, part in self.slots.items()}, "dt": p[self.slices[TIME_STEP]]}
