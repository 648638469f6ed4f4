"""Low-level controllers to compare with: the solver's feedback, and feed-forward controls with gains on joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .low_level import JointPD, LowLevel
from .plan import PlanStage, StagedPlan

Array = NDArray[np.float64]


class Riccati(LowLevel):
    """The solver's feedback, u = ū + K (x ⊖ x̄); see :class:`LowLevel`."""

    def _control(self, at: PlanStage, x: Array, deviation: Array) -> Array:
        control: Array = at.u + at.feedback @ deviation
        return control


class FeedforwardPD(LowLevel):
    """The plan's control with gains on the joints, u = ū + kp (q̄ − q) + kd (v̄ − v); see :class:`LowLevel`.

    Args:
        plan: the plan.
        kp: a number, or one per control [Nm/rad].
        kd: a number, or one per control [Nm s/rad].
        damping: of the last resort [Nm s/rad].
    """

    def __init__(
        self,
        plan: StagedPlan,
        *,
        kp: float | Sequence[float] = 20.0,
        kd: float | Sequence[float] = 0.5,
        damping: float = 1.0,
    ) -> None:
        super().__init__(plan, gains=JointPD(kp, kd), damping=damping)

    def _control(self, at: PlanStage, x: Array, deviation: Array) -> Array:
        return at.u
