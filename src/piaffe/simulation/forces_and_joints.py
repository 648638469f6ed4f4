"""A low level for plans of contact forces and joint motions without torques."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError
from piaffe.models import HybridKinodynamic, base, feet, joints
from piaffe.ocp import SAME_TIME, Manifold, rotation

from .part_of_state import indices_of_part

Array = NDArray[np.float64]


class ForcesAndJoints:
    """Torques of planned contact forces, and gains that keep the joints to their planned motion.

    With the forces f of the feet on the ground in the stage of the plan at a time, and J the derivative of the places
    of the feet in base axes by the joint angles, at the measured state::

        τ = −Jᵀ Rᵀ f + s (kp (q̄ − q) + kd (q̄' − q'))

    The angles q̄ are interpolated between the nodes of the plan, the velocity q̄' is that between them. The factor s of
    a leg is ``in_stance`` on the ground, else 1. Torques are kept within the robot's limits.

    It is a low level without a value function or a feedback on the base, as published with [Li2022Versatile].

    Args:
        model: the model of the plan.
        plan: its first plan.
        whole: the state space of the plant, ``plant.space``.
        kp: a number, or one per joint [Nm/rad].
        kd: a number, or one per joint [Nm s/rad].
        in_stance: factor of the gains of legs on the ground.

    Raises:
        ModelError: a gain is out of range, or the plant lacks a part of the model's state.
    """

    def __init__(
        self,
        model: HybridKinodynamic,
        plan: Any,
        whole: Manifold,
        *,
        kp: float | ArrayLike = 20.0,
        kd: float | ArrayLike = 0.5,
        in_stance: float = 1.0,
    ) -> None:
        robot = model.robot
        for name, gains in (("kp", kp), ("kd", kd), ("in_stance", in_stance)):
            values = np.asarray(gains, dtype=float)
            if values.shape not in ((), (robot.num_joints,)) or not np.all((values >= 0) & np.isfinite(values)):
                raise ModelError(
                    f"forces and joints, {name}: is out of range - got {gains!r}, expected a number ≥ 0, or one for "
                    f"each of {robot.num_joints} joints; change it"
                )
        self.model, self.plan = model, plan
        self._kp, self._kd = (np.broadcast_to(np.asarray(each, dtype=float), robot.num_joints) for each in (kp, kd))
        self._in_stance, self._limit = float(in_stance), robot.torque_limit
        self._foot = np.asarray(robot.foot_of_joint)
        self._indices, self._rates = indices_of_part(model.state, whole), whole.slices[joints.velocity]
        self._q, self._turn = model.state.slices[joints.position], model.state.slices[base.orientation]

    def follow(self, plan: Any) -> None:
        """Follow another plan from now on."""
        self.plan = plan

    def control(self, x: ArrayLike, t: float) -> Array:
        """Return the torques of a state of the plant (nx,) at time t [s], (n,) [Nm]."""
        measured = np.asarray(x, dtype=float)
        phase, k, share = self._stage(t)
        angles, step = phase.states[:, self._q], phase.times[k + 1] - phase.times[k]
        state, local = measured[self._indices], getattr(self.plan, "local", None)
        state = state if local is None else local(state)
        q = state[self._q]
        flags = phase.p[k, phase.mode.layout.slots["contact"]] > 0.5
        told = phase.controls[k, self.model.control.slices[feet.force]].reshape(-1, 3) * flags[:, None]
        torques = self._torques(q, told @ rotation.np_matrix(state[None, self._turn])[0])
        change = angles[k + 1] - angles[k]
        factor = np.where((self._foot >= 0) & np.append(flags, False)[self._foot], self._in_stance, 1.0)
        torques += factor * self._kp * (angles[k] + share * change - q)
        torques += factor * self._kd * (change / step - measured[self._rates])
        return np.clip(torques, -self._limit, self._limit)

    def _torques(self, q: Array, forces: Array) -> Array:
        """Return the torques with which the feet push, for forces on the feet in base axes (nf, 3) [N], (n,)."""
        torques = np.zeros(len(q))
        for legs in self.model.kinematics.groups:
            _, jacobian = legs.jacobian(q[legs.joints])
            torques[legs.joints] = -np.einsum("mik,mi->mk", jacobian, forces[legs.feet])
        return torques

    def _stage(self, t: float) -> tuple[Any, int, float]:
        """Return the phase, the stage and the share of it that is over at a time; before and after, its ends."""
        phases = self.plan.phases
        phase = next((each for each in reversed(phases) if each.times[0] <= t + SAME_TIME), phases[0])
        times = np.asarray(phase.times)
        k = int(np.clip(np.searchsorted(times, t + SAME_TIME, side="right") - 1, 0, len(times) - 2))
        return phase, k, float(np.clip((t - times[k]) / (times[k + 1] - times[k]), 0.0, 1.0))
