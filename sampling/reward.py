"""The reward as a function of the running cost, the same for planner and learner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from piaffe.errors import SamplingError

from .namespace import namespace


@dataclass(frozen=True)
class Reward:
    """The reward exp(−l / s) in (0, 1] of the running cost l = ½ Σ w r² per unit of time.

    A discounted return needs rewards that are not negative: with negative rewards, the discount would make violations
    increase the return.

    Args:
        scale: s, the cost at which the reward is 1/e; in the objective's units.
    """

    scale: float = 1.0

    def __post_init__(self) -> None:
        if not (isinstance(self.scale, int | float | np.number) and 0 < self.scale < float("inf")):
            raise SamplingError(
                f"reward: scale is out of range - got {self.scale!r}, expected a positive number in the units of the "
                "objective; give the cost at which the reward is 1/e"
            )

    def __call__(self, cost: Any) -> Any:
        """Return the reward of costs of any shape, arrays of NumPy or JAX."""
        return namespace(cost).exp(cost * (-1.0 / self.scale))
