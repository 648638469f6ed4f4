"""TD-CD-MPPI: annealed MPPI with returns that violations discount and that include a learnt value at the end."""

from __future__ import annotations

from collections.abc import Collection
from os import PathLike
from typing import Any, ClassVar

from piaffe.ocp import Problem

from ..options import Options
from ..reward import Reward
from . import reduce
from .dial import DIAL
from .discount import ConstraintDiscount, discounted_return
from .stage import Memory, Rolled, TerminalValue


class TDCDMPPI(DIAL):
    """Constraint-discounted MPPI with a terminal value [TD-CD-MPPI].

    The return of a roll-out with rewards r, violations' discounts δ and value V is::

        R = Σ_h [Π_{k≤h} γ₀ (1 − δ_k)] r_h + [Π_{k≤H} γ₀ (1 − δ_k)] V(x_{H+1})

    δ is scaled by moving maxima of the violations, which are in the memory. Without a value, the reward of terms
    ``at="end"`` is used in its place, if there are such terms.

    Args:
        problem: as for :class:`Sampler`.
        options: see :class:`Options`.
        reward: the reward as a function of the cost.
        value: V, or the path of its file; None for no value.
        allow: entries that may differ between this controller and the one that the value was learnt for, as
            ``("terrain",)``; see :meth:`piaffe.sampling.value.Value.check`.
        **changed: single options.

    Raises:
        SamplingError: the value was learnt for another robot, objective, reward or discount.
        UnknownNameError: ``p_max`` has the name of an unknown constraint.
    """

    title: ClassVar[str] = "TD-CD-MPPI"
    defaults: ClassVar[Options] = Options(samples=512)
    uses_value: ClassVar[bool] = True

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
        super().__init__(problem, options, reward=reward, value=value, allow=allow, **changed)
        self.discount = ConstraintDiscount.of(self.constraints, self.options)

    def initial_memory(self) -> Memory:
        """Return the moving maxima before the first batch."""
        return self.discount.initial_memory()

    def returns(self, xp: Any, rolled: Rolled, memory: Memory) -> tuple[Any, Memory]:
        """Return the constraint-discounted return of every roll-out, (n,), and the moving maxima of the violations."""
        memory = self.discount.follow(memory, reduce.maxima(rolled.violation, rolled.failed))
        delta = self.discount.delta(rolled.violation, memory)
        end = rolled.value
        if end is None and rolled.last is not None:
            end = self.reward(rolled.last)
        return discounted_return(self.reward(rolled.cost), delta, self.options.discount, end), memory
