"""PD gains on joints, added to a control."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ShapeError, SolverError
from piaffe.ocp import LoweredMode

from .components import driven

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointPD:
    """Gains on joint angles and speeds, added to a control: u + s (kp (q̄ − q) + kd (v̄ − v)).

    Joints are the state's positions and velocities with the labels of the controls. The factor s of a joint is
    ``in_stance`` while the point that it moves is in contact, else 1. The gains of [Li2025CafeMpc] are, for legs of
    three joints, ``JointPD(3.0, (1.0, 0.5, 0.5) * 4, in_stance=0.25, contact_of=robot.foot_of_joint)``.

    Args:
        kp: a number, or one per control [Nm/rad].
        kd: a number, or one per control [Nm s/rad].
        in_stance: factor of the gains of joints whose point is in contact.
        contact_of: per control the index of its contact flag, -1 for none; ``models.Robot.foot_of_joint``.

    Raises:
        SolverError: a factor is given without ``contact_of``, or is negative.
    """

    kp: float | Sequence[float] = 3.0
    kd: float | Sequence[float] = 0.5
    in_stance: float = 1.0
    contact_of: Sequence[int] | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.in_stance < np.inf:
            raise SolverError(
                f"joint gains: in_stance out of range - got {self.in_stance}, expected a finite number ≥ 0; change it"
            )
        if self.in_stance != 1.0 and self.contact_of is None:
            raise SolverError(
                f"joint gains: in_stance without contact_of - got {self.in_stance}, expected the index of a contact "
                "flag per control; give contact_of, as robot.foot_of_joint"
            )

    @property
    def by_contact(self) -> bool:
        """Whether the gains depend on contacts."""
        return self.contact_of is not None

    def numbers(self, mode: LoweredMode, num_contacts: int) -> tuple[Array, Array, NDArray[np.int32]]:
        """Return kp, kd and the index of the contact flag of every control, each (nu,).

        Raises:
            SolverError: the state has no velocities of the controls, or there is no such contact flag.
            ShapeError: another number of gains than of controls.
        """
        driven(mode)
        found = []
        for name, given in (("kp", self.kp), ("kd", self.kd), ("contact_of", self.contact_of)):
            values = np.asarray(-1 if given is None else given)
            if values.shape not in ((), (mode.nu,)):
                raise ShapeError(
                    f"joint gains, {name}: wrong size - got shape {values.shape}, expected a number or ({mode.nu},); "
                    "give one per control"
                )
            found.append(np.broadcast_to(values, mode.nu))
        kp, kd, index = found[0] + 0.0, found[1] + 0.0, np.ascontiguousarray(found[2], dtype=np.int32)
        if self.by_contact and not (index.min(initial=0) >= -1 and index.max(initial=-1) < num_contacts):
            raise SolverError(
                f"joint gains, contact_of: no such contact flag - got {index.tolist()}, expected numbers from -1 to "
                f"{num_contacts - 1}; fix it"
            )
        return kp, kd, index

    def __call__(self, mode: LoweredMode, deviation: Array, in_contact: Array) -> Array:
        """Return −s (kp (q − q̄) + kd (v − v̄)) of a deviation x ⊖ x̄ (ndx,), (nu,).

        Args:
            mode: the mode of the stage.
            deviation: x ⊖ x̄ (ndx,).
            in_contact: contact flags (nf,).
        """
        kp, kd, index = self.numbers(mode, len(in_contact))
        joints = driven(mode)
        on = (index >= 0) & (np.append(in_contact, 0.0)[index] > 0.5)
        scale = np.where(on, self.in_stance, 1.0)
        return -scale * (kp * deviation[joints.position] + kd * deviation[joints.velocity])
