"""A policy as a controller in episodes; it computes the control at every tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import SamplingError
from piaffe.models import Mujoco, base, joints
from piaffe.ocp import Policy

from .controller import Judgement

Array = NDArray[np.float64]

Judge = Callable[[Array, Array, float], Judgement]
"""A function of states (T, nx), actions (T, nu) and the time of the first [s], which returns their cost."""


@dataclass(frozen=True, eq=False)
class PolicyPlan:
    """The control of a policy at the time of a plan.

    Args:
        action: (nu,) [Nm].
        seconds: empty, because nothing is planned.
        figures: empty.
    """

    action: Array
    seconds: Mapping[str, float] = field(default_factory=dict)
    figures: Mapping[str, float] = field(default_factory=dict)


class PolicyController:
    """A :class:`TickingController` that applies a policy, u = ū + K (x ⊖ x̄), at every tick.

    Args:
        policy: policy of a plan for the whole-body model of this robot.
        model: the robot, with ``action=models.torques()``; its ``dt`` is the time between plans.
        tick_dt: time between ticks [s]; by default a step of the model's simulator.
        judge: cost of an episode's states and controls. By default the cost is |x ⊖ x̄|², the squared distance from the
            plan in the tangent, the reward is exp(−cost), and there are no constraints.

    Raises:
        SamplingError: the model's controls are not torques, or its states have another size than the policy's.
    """

    def __init__(
        self, policy: Policy, model: Mujoco, *, tick_dt: float | None = None, judge: Judge | None = None
    ) -> None:
        if model.action.quantity != joints.torque:
            raise SamplingError(
                f"policy: model '{model.name}' has other controls - got '{model.action.quantity.path}', expected "
                f"'{joints.torque.path}'; make it with action=models.torques()"
            )
        if policy.initial.shape != (model.state.nx,):
            raise SamplingError(
                f"policy: model '{model.name}' has other states - got {model.state.nx}, expected "
                f"{policy.initial.size}; give the robot that the plan is for"
            )
        self.policy, self.model = policy, model
        self.dt, self.tick_dt = model.dt, model.timestep if tick_dt is None else float(tick_dt)
        self._judge = judge or self._distance

    @property
    def initial(self) -> Array:
        """First state of the plan, (nx,)."""
        return self.policy.initial

    def reset(self, seed: int | None = None) -> None:
        """Do nothing: a policy has no memory and no random numbers."""

    def hold(self, x: Array) -> Array:
        """Return the policy's control at the plan's start, (nu,) [Nm]."""
        return self.policy.control(x, self.policy.start)

    def plan(self, x: ArrayLike, t: float) -> PolicyPlan:
        """Return the policy's control for a state (nx,) at a time [s]."""
        return PolicyPlan(self.policy.control(np.asarray(x, dtype=float), t))

    def tick(self, x: Array, t: float) -> Array:
        """Return u = ū + K (x ⊖ x̄), (nu,) [Nm]."""
        return self.policy.control(x, t)

    def judge(self, states: Array, actions: Array, t: float) -> Judgement:
        """Return cost, reward and violations of states and controls.

        Args:
            states: (T, nx), at intervals of ``dt``.
            actions: (T, nu).
            t: time of the first state [s].
        """
        return self._judge(states, actions, t)

    def place(self, t: float) -> Array:
        """Return the planned position of the base at a time [s], x and y, (2,) [m]."""
        planned = self.policy.planned(t)
        return planned.state[planned.part.state.slices[base.position]][:2]

    def _distance(self, states: Array, actions: Array, t: float) -> Judgement:
        off = np.array([self.policy.off(x, t + k * self.dt) for k, x in enumerate(states)])
        cost = np.sum(off**2, axis=1)
        return Judgement(cost, np.exp(-cost), np.zeros((0, len(states))), ())
