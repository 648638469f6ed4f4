"""Parameters: numbers of the user that can change without a new compilation."""

from __future__ import annotations

from typing import Any
from weakref import WeakValueDictionary

import casadi as cs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError

from .source import caller
from .user_input import numbers_of


class Parameter(cs.SX):
    """A named number or column of numbers, used in a user's functions like any CasADi expression."""

    def __init__(self, name: str, value: ArrayLike) -> None:
        where = f"parameter '{name}' ({caller()})"
        self.value: NDArray[np.float64] = numbers_of(value, where, "value")
        if self.value.ndim != 1 or not np.all(np.isfinite(self.value)):
            raise ProblemError(
                f"{where}: value is unusable - got {value!r}, expected finite numbers in one column; fix it"
            )
        if not isinstance(name, str) or not name or "." in name:
            raise ProblemError(
                f"{where}: name is unusable - got {name!r}, expected some text without a dot: a dot separates the name "
                "of a model or a term from the name of its parameter; rename it"
            )
        self.label = name
        super().__init__(cs.SX.sym(name, self.value.size))
        for element in cs.symvar(self):
            _BY_SYMBOL[element.element_hash()] = self

    def __hash__(self) -> int:
        return id(self)

    def __repr__(self) -> str:
        return f"parameter({self.label!r}, {self.value.tolist()})"


# CasADi returns the symbols of an expression as plain expressions; this dictionary has the parameter of each.
_BY_SYMBOL: WeakValueDictionary[int, Parameter] = WeakValueDictionary()


def parameter(name: str, value: ArrayLike) -> Parameter:
    """Return a number that can change between solves without a new compilation.

    Args:
        name: its name, unique within a problem, without a dot.
        value: its default, a number or a column of numbers.
    """
    return Parameter(name, value)


def find_parameter(symbol: Any) -> Parameter | None:
    """Return the parameter that a CasADi symbol belongs to, or None."""
    return _BY_SYMBOL.get(symbol.element_hash())
