"""What low-level controllers share: the deviation from the plan, bounds of single controls, and PD gains on joints."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ShapeError, SolverError, UnknownNameError
from piaffe.ocp import LoweredMode, Manifold

from .plan import PlanStage, StagedPlan, modes_of, stage_at
from .rows import ControlRows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointPD:
    """Gains on joint angles and speeds, added to a control: u + kp (q̄ − q) + kd (v̄ − v).

    Joints are the state's positions and velocities with the labels of the controls.

    Args:
        kp: a number, or one per control [Nm/rad].
        kd: a number, or one per control [Nm s/rad].
    """

    kp: float | Sequence[float] = 3.0
    kd: float | Sequence[float] = 0.5

    def __call__(self, mode: LoweredMode, deviation: Array) -> Array:
        """Return −kp (q − q̄) − kd (v − v̄) of a deviation x ⊖ x̄ (ndx,), (nu,)."""
        joints = driven(mode)
        return -np.asarray(self.kp) * deviation[joints.position] - np.asarray(self.kd) * deviation[joints.velocity]


class Driven(NamedTuple):
    """The slices, in the tangent of the state, of the positions and velocities that the controls drive."""

    position: slice
    velocity: slice


def driven(mode: LoweredMode) -> Driven:
    """Return the positions and velocities with the labels of the controls.

    Raises:
        SolverError: the state has no such velocities.
    """
    labels = tuple(label for block in mode.model.control.blocks for label in block.labels)
    for block in mode.state.blocks:
        if block.rate_of is not None and block.labels == labels:
            slices = mode.state.tangent_slices
            return Driven(slices[block.rate_of], slices[block.quantity])
    names = ", ".join(label.strip() for label in mode.model.control.labels)
    raise SolverError(
        f"joint gains, model '{mode.model.name}': the state has no velocities of the controls - got controls {names}, "
        "expected a block of the state with these labels that is the rate of another; leave the gains out"
    )


class LowLevel(ABC):
    """A controller that follows a plan: ``control(x, t)`` is the control of a state at a time.

    The control is kept within the declared bounds of single controls. If a number is not finite, the control is
    −damping times the speeds of the joints, as far as these are finite, else zero; ``damped`` counts these.

    Args:
        plan: the plan.
        leave_out: components of the state that do not count in x ⊖ x̄, by name, or by quantity for all of them:
            ``("base.position x", "base.position y")``.
        gains: added to the control; none by default.
        damping: of the last resort [Nm s/rad].

    Raises:
        UnknownNameError: no state of the plan has such a component.
        SolverError: gains are given, and the state has no velocities of the controls.
    """

    def __init__(
        self,
        plan: StagedPlan,
        *,
        leave_out: Sequence[str] = (),
        gains: JointPD | None = None,
        damping: float = 1.0,
    ) -> None:
        self.plan, self.gains, self.damping = plan, gains, damping
        self.rows = {mode: ControlRows(mode) for mode in modes_of(plan)}
        self._kept = {mode: kept(mode.state, leave_out, type(self).__name__) for mode in modes_of(plan)}
        if gains is not None:
            for mode in modes_of(plan):
                driven(mode)
        self.ticks = self.damped = 0

    def control(self, x: ArrayLike, t: float) -> Array:
        """Return the control of a state (nx,) at time t [s], (nu,).

        Raises:
            ShapeError: the state has another size than the plan's at this time.
        """
        state, at = np.asarray(x, dtype=float), stage_at(self.plan, t)
        if state.shape != at.x.shape:
            raise ShapeError(
                f"{type(self).__name__}: state has the wrong size - got shape {state.shape}, expected {at.x.shape}; "
                f"give a state of model '{at.mode.model.name}'"
            )
        self.ticks += 1
        if np.isfinite(state).all():
            deviation = at.mode.state.np_minus(state, at.x)
            u = self._control(at, state, deviation * self._kept[at.mode])
            if self.gains is not None:
                u = u + self.gains(at.mode, deviation)
            u = self.bounded(at, state, u)
            if np.isfinite(u).all():
                return u
        self.damped += 1
        return self.bounded(at, at.x, self._damp(at.mode, state))

    __call__ = control

    @abstractmethod
    def _control(self, at: PlanStage, x: Array, deviation: Array) -> Array:
        """Return the control of a finite state and its deviation, (nu,); bounds are applied to the result."""

    def bounded(self, at: PlanStage, x: Array, u: Array) -> Array:
        """Return a control within the declared bounds of single controls at a state, (nu,)."""
        p, g_mask, _ = self._numbers(at)
        return np.clip(u, *self.rows[at.mode].limits(x, p, g_mask))

    def _numbers(self, at: PlanStage) -> tuple[Array, Array, Array]:
        """Return the parameters of a stage, and the masks of its inequality and equality rows."""
        return at.p, at.g_mask, at.h_mask

    def _damp(self, mode: LoweredMode, x: Array) -> Array:
        """Return −damping v of the joints; zero for speeds that are not finite or that the state does not have."""
        u = np.zeros(mode.nu)
        labels = tuple(label for block in mode.model.control.blocks for label in block.labels)
        for block in mode.state.blocks:
            if block.rate_of is not None and block.labels == labels:
                speed = x[mode.state.slices[block.quantity]]
                u = -self.damping * np.where(np.isfinite(speed), speed, 0.0)
        return u


def kept(space: Manifold, leave_out: Sequence[str], where: str) -> Array:
    """Return 0 for the components of the tangent that are left out, 1 for the others (ndx,)."""
    names = [label.strip() for label in space.labels]
    flags = np.ones(space.ndx)
    for name in leave_out:
        own = [i for i, label in enumerate(names) if label == name or label.startswith(f"{name} ")]
        if not own:
            raise UnknownNameError(where, "component of the state", name, names)
        flags[own] = 0.0
    return flags
