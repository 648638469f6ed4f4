"""TD-CD-MPPI: annealed MPPI whose returns are discounted by violations and end in a learned value."""

from __future__ import annotations

from collections.abc import Collection
from os import PathLike
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SamplingError
from piaffe.ocp import Nodes, Problem

from ..options import Options
from ..reward import Reward
from ..value import Value, load_value
from . import reduce
from .dial import DIAL
from .discount import ConstraintDiscount, discounted_return
from .mppi import Rolled

Array = NDArray[np.float64]


class TerminalValue(Protocol):
    """What a roll-out that ends in a state is still going to return."""

    def __call__(self, states: Array, k: int, nodes: Nodes) -> Array:
        """Return V ≥ 0 of states (n, nx) at node k, (n,)."""
        ...


class TDCDMPPI(DIAL):
    """Constraint-discounted MPPI with a terminal value [TD-CD-MPPI].

    The return of a roll-out with rewards r, violations' discounts δ and value V is::

        R = Σ_h [Π_{k≤h} γ₀ (1 − δ_k)] r_h + [Π_{k≤H} γ₀ (1 − δ_k)] V(x_{H+1})

    Args:
        problem: as for :class:`MPPI`.
        options: see :class:`Options`.
        reward: how cost becomes reward.
        value: V, or the file that holds it; None for none.
        allow: what may differ between this controller and the one that the value was learned from, as ``("terrain",)``;
            see :meth:`piaffe.sampling.value.Value.check`.
        **changed: single options.

    Raises:
        SamplingError: the value was learned for another robot, objective, reward or discount.
    """

    defaults: ClassVar[Options] = Options(samples=512)

    def __init__(
        self,
        problem: Problem,
        options: Options | None = None,
        *,
        reward: Reward | None = None,
        value: TerminalValue | str | PathLike[str] | None = None,
        allow: Collection[str] = (),
        **changed: Any,
    ) -> None:
        super().__init__(problem, options, reward=reward, **changed)
        self.discount = ConstraintDiscount(self.constraints, self.options)
        self.value = self._checked_value(value, allow)

    def reset(self, seed: int | None = None) -> None:
        """Forget the last plan and the largest violations, and begin the perturbations anew."""
        super().reset(seed)
        if hasattr(self, "discount"):
            self.discount.reset()

    def _checked_value(
        self, value: TerminalValue | str | PathLike[str] | None, allow: Collection[str]
    ) -> TerminalValue | None:
        if isinstance(value, str | PathLike):
            return load_value(value, self, allow=allow)
        if isinstance(value, Value):
            value.check(self.nodes, self.reward, self.options, allow)
        elif not (value is None or callable(value)):
            raise SamplingError(
                f"controller: value is unusable - got {type(value).__name__}, expected a function of states, a "
                "Value, or the path of one; learn one by piaffe.sampling.train_value"
            )
        return value

    def returns(self, rolled: Rolled) -> Array:
        """Return the constraint-discounted return of every roll-out, (n,)."""
        alive = ~rolled.failed
        seen = rolled.violation if alive.all() else rolled.violation[:, alive]
        self.discount.follow(reduce.maxima(seen))
        delta = self.discount.of(rolled.violation)
        value = None
        if self.value is not None:
            value = self.value(rolled.states[:, -1], rolled.k + self.steps + 1, self.nodes)
        elif rolled.last is not None:
            value = self.reward(rolled.last)
        return discounted_return(self.reward(rolled.cost), delta, self.options.discount, value)

    def _moving_maxima(self) -> Array | None:
        return self.discount.moving

    def _set_maxima(self, maxima: Array) -> None:
        self.discount.reset(maxima)
