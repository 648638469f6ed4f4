"""The reward: a running cost as something to collect, the same for planner and learner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from piaffe.errors import SamplingError

from .namespace import namespace


@dataclass(frozen=True)
class Reward:
    """r = exp(−l / s) in (0, 1] of the running cost l = ½ Σ w r², a rate.

    A discounted return needs rewards that are not negative: discounting a penalty would make violations attractive.

    Args:
        scale: s, the cost at which the reward has fallen to 1/e; in the objective's units.
    """

    scale: float = 1.0

    def __post_init__(self) -> None:
        if not (isinstance(self.scale, int | float | np.number) and 0 < self.scale < float("inf")):
            raise SamplingError(
                f"reward: scale is out of range - got {self.scale!r}, expected a positive number in the units of the "
                "objective; give the cost at which the reward has fallen to 1/e"
            )

    def __call__(self, cost: Any) -> Any:
        """Return the reward of costs of any shape, arrays of NumPy or JAX."""
        return namespace(cost).exp(cost * (-1.0 / self.scale))
