"""Layouts: named slices of a flat vector of numbers."""

from __future__ import annotations

from collections.abc import Iterable

import casadi as cs


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
