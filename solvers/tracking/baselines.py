"""Low-level controllers to compare with: the solver's feedback, and feed-forward controls with gains on joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .contacts import Contacts
from .gains import JointPD
from .low_level import Backend, LowLevel
from .memory import Law
from .plan import CONTACT, PlanStage, StagedPlan

Array = NDArray[np.float64]


class Riccati(LowLevel):
    """The solver's feedback, u = ū + K (x ⊖ x̄); see :class:`LowLevel`."""

    law = Law.FEEDBACK

    def _control(self, at: PlanStage, x: Array, deviation: Array) -> Array:
        control: Array = at.u + at.feedback @ deviation
        return control


class FeedforwardPD(LowLevel):
    """The plan's control with gains on the joints, u = ū + kp (q̄ − q) + kd (v̄ − v); see :class:`LowLevel`.

    Args:
        plan: the plan.
        kp: a number, or one per control [Nm/rad].
        kd: a number, or one per control [Nm s/rad].
        in_stance: factor of the gains in stance, see :class:`JointPD`.
        contact_of: per control the index of its contact flag, see :class:`JointPD`.
        damping: of the last resort [Nm s/rad].
        contacts: ``"schedule"``, ``"measured"`` or settings, see :class:`LowLevel`.
        contact_slot: slot of the models with the contact flags.
        backend: ``"native"``: the whole tick in C; ``"numpy"`` is the readable reference, also without a compiler.
    """

    law = Law.FEEDFORWARD

    def __init__(
        self,
        plan: StagedPlan,
        *,
        kp: float | Sequence[float] = 20.0,
        kd: float | Sequence[float] = 0.5,
        in_stance: float = 1.0,
        contact_of: Sequence[int] | None = None,
        damping: float = 1.0,
        contacts: Contacts = "schedule",
        contact_slot: str = CONTACT,
        backend: Backend = "native",
    ) -> None:
        gains = JointPD(kp, kd, in_stance, contact_of)
        super().__init__(
            plan, gains=gains, damping=damping, contacts=contacts, contact_slot=contact_slot, backend=backend
        )

    def _control(self, at: PlanStage, x: Array, deviation: Array) -> Array:
        return at.u
