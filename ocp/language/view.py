"""The argument of a user's function: the quantities of one node, as attributes."""

from __future__ import annotations

from typing import Any

import casadi as cs

from .model import Quantities
from .quantity import Bound


class Values(cs.SX):
    """A bound quantity: a CasADi expression with components by index or by name, ``position["FL_HAA"]``."""

    def __init__(self, bound: Bound) -> None:
        super().__init__(bound.value)
        self.bound = bound

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str):
            return cs.SX(self)[self.bound.indices(key)]
        return super().__getitem__(key)


def column(value: Any) -> cs.SX:
    """Return the result of a user's function - an expression, number, array or list of these - as one column."""
    return cs.vec(cs.SX(cs.vertcat(*value) if isinstance(value, list | tuple) else value))


class NodeView:
    """The quantities of one node: ``s.joints.position``, ``s.frames["FL_KFE"].position[2]``, ``s.vz``.

    Args:
        quantities: the quantities that the model supplies.
        prefix: first part of the path, up to this attribute.
    """

    def __init__(self, quantities: Quantities, prefix: str = "") -> None:
        self._quantities = quantities
        self._prefix = prefix

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        path = f"{self._prefix}.{name}" if self._prefix else name
        if path in self._quantities:
            return Values(self._quantities.bind(path))
        if any(known.startswith(path + ".") for known in self._quantities.paths):
            return NodeView(self._quantities, path)
        raise self._quantities.unknown(path)

    def __getitem__(self, name: str) -> Any:
        return self.__getattr__(name)
