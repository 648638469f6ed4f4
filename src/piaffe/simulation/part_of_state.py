"""States of a plant for planners whose models have a part of them: a rigid body without joints or joint velocities."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError
from piaffe.ocp import Manifold

from .planner import Planner

Array = NDArray[np.float64]


def indices_of_part(part: Manifold, whole: Manifold) -> NDArray[np.intp]:
    """Return where the components of a smaller state are in a larger one, (nx of the part,).

    Raises:
        ModelError: the larger state lacks a part of the smaller one.
    """
    for block in part.blocks:
        own = [each for each in whole.blocks if each.quantity == block.quantity and each.labels == block.labels]
        if not own:
            names = ", ".join(each.quantity.path for each in whole.blocks)
            raise ModelError(
                f"part of a state: '{block.quantity.path}' is missing - got a state of {names}, expected its "
                f"{block.ndx} components with the same names; use the plant of the model's robot"
            )
    where = whole.slices
    return np.concatenate([np.arange(where[b.quantity].start, where[b.quantity].stop) for b in part.blocks])


class PartOfState:
    """A planner for :func:`run_online` that plans from a part of the plant's state.

    Args:
        planner: the planner, for a model with fewer states, as ``models.HybridKinodynamic``.
        part: the state space of this model.
        whole: that of the plant, ``plant.space``.

    Raises:
        ModelError: the plant lacks a part of the model's state.
    """

    def __init__(self, planner: Planner, part: Manifold, whole: Manifold) -> None:
        self.planner, self._indices = planner, indices_of_part(part, whole)

    @property
    def period(self) -> float:
        """Time between plans [s]."""
        return self.planner.period

    def reset(self) -> None:
        """Delete the last plan."""
        self.planner.reset()

    def plan(self, x: ArrayLike, t: float) -> Any:
        """Return a plan from a state of the plant (nx,) that was measured at time t [s]."""
        return self.planner.plan(np.asarray(x, dtype=float)[self._indices], t)

    def command(self, **values: float) -> None:
        """Pass commands on to the planner."""
        asked: Any = self.planner
        asked.command(**values)

    def velocity(self, t: float) -> Array:
        """Return the commanded velocity ahead, to the left [m/s], and yaw rate [rad/s], (3,); NaN if unknown."""
        known = getattr(self.planner, "velocity", None)
        return np.asarray(known(t), dtype=float) if callable(known) else np.full(3, np.nan)
