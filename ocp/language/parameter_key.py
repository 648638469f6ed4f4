"""Keys of parameters: what each part of a node's parameter vector ``p`` holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

ParameterKind = Literal[
    "dt", "slot", "parameter", "weight", "target", "lower", "upper", "active", "has_lower", "has_upper"
]


@dataclass(frozen=True)
class ParameterKey:
    """The key of a part of a node's parameter vector ``p``.

    =====================================================  ===========================================================
    key                                                    part
    =====================================================  ===========================================================
    ``ParameterKey("dt")``                                 the time step [s]
    ``ParameterKey("slot", "contact", model="solo12")``    a :class:`Slot` of a model
    ``ParameterKey("parameter", "mu")``                    an ``ocp.parameter``
    ``ParameterKey("parameter", "mu", term=3)``            a parameter of the term itself
    ``ParameterKey("weight", term=3)``                     a cost's weights, ``"target"`` its target
    ``ParameterKey("lower", term=3)``                      a constraint's lower bounds, ``"upper"`` its upper bounds
    ``ParameterKey("has_lower", term=3)``                  1 per row that has this bound, 0 if it is infinite
    ``ParameterKey("active", term=3)``                     1 where a constraint applies, 0 elsewhere
    =====================================================  ===========================================================

    Args:
        kind: kind of the number.
        name: name of the slot or of the parameter; empty for the other kinds.
        model: name of the model that has the slot; empty for the other kinds.
        term: index into the problem's terms; None if the number belongs to no term.
        positive: whether its values must be above zero, see :class:`Slot`; it does not count in comparisons.
        check: what else must hold for its values, see :class:`Slot`; it does not count in comparisons.
    """

    kind: ParameterKind
    name: str = ""
    model: str = ""
    term: int | None = None
    positive: bool = field(default=False, compare=False)
    check: Callable[[NDArray[np.float64]], str] | None = field(default=None, compare=False, repr=False)

    @property
    def is_bound(self) -> bool:
        """Whether the part is a constraint's bound, which may be infinite."""
        return self.kind in _HAS

    @property
    def has_bound(self) -> ParameterKey:
        """The key of the flags that are 1 for the finite entries of this bound."""
        return ParameterKey(_HAS[self.kind], term=self.term)


_HAS: dict[ParameterKind, ParameterKind] = {"lower": "has_lower", "upper": "has_upper"}

TIME_STEP = ParameterKey("dt")
