"""Simulation of a policy in MuJoCo; contacts are simulated, not prescribed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.models import Mujoco, Robot, SoftContact, terrain, torques
from piaffe.ocp import Policy

from .simulation import Simulation

Array = NDArray[np.float64]

_UNLIMITED = 1e6  # [Nm]: the range of a control needs a number; the actuator of such a joint has no limit

Control = Callable[[Array, float], Array]
"""A low-level controller: the control (nu,) [Nm] of a state (nx,) at a time [s]."""

LOST_M, LOST_RAD = 0.3, 1.0
"""The plan is lost if the error of the base, or of a joint of an arm, exceeds this, in position or in orientation."""


@dataclass(frozen=True, eq=False)
class PolicyRun:
    """The record of a simulated policy, at T steps of the simulator.

    Args:
        times: (T,) [s].
        states: states of the plant (T, nx).
        planned: states of the plan (T, nx).
        phases: index of the plan's phase, (T,).
        forces: forces on the feet in world axes (T, nf, 3) [N], in the step before each state.
        slips: how far each foot slipped on the ground (T, nf) [m], in the step before each state.
        touching: names of the parts that are no feet and touch the ground, per step; empty if none does.
        position: position error of the base (T,) [m]. orientation: its orientation error (T,) [rad]. With a fixed base,
            zero and the largest error of a joint's position.
        full: whether each torque was at its limit, (T, nu).
        lost_at: time at which the plan was lost [s]; None if it was followed to its end.
        duration: duration of the plan [s].
        saturated: fraction of the steps at which a torque was at its limit.
    """

    times: Array
    states: Array
    planned: Array
    phases: NDArray[np.int_]
    forces: Array
    slips: Array
    touching: tuple[tuple[str, ...], ...]
    position: Array
    orientation: Array
    full: NDArray[np.bool_]
    lost_at: float | None
    duration: float
    saturated: float

    def __str__(self) -> str:
        if self.lost_at is None:
            how = f"followed the plan to its end, {self.duration:.2f} s"
        else:
            how = f"lost the plan at {self.lost_at:.2f} s of {self.duration:.2f} s"
        return (
            f"simulation {how}; error of the base at most {self.position.max():.3f} m and "
            f"{self.orientation.max():.3f} rad, at the end {self.position[-1]:.3f} m and "
            f"{self.orientation[-1]:.3f} rad; torque limits reached in {100 * self.saturated:.0f} % of the steps"
        )


def torque_plant(
    robot: Robot, *, timestep: float = 1e-3, friction: float = 0.6, ground: terrain.Terrain | None = None
) -> Mujoco:
    """Return a robot with torques as controls and with stiffer contacts than MuJoCo's default.

    Feet, base and knees collide with the ground. The friction cone is elliptic: a force along the ground is at most the
    friction coefficient times the normal force, in every direction.

    Args:
        robot: the robot.
        timestep: time step of the simulator [s].
        friction: sliding friction coefficient of the robot's surface.
        ground: the ground; level at z = 0 by default.
    """
    contact = SoftContact(
        solref=(max(4 * timestep, 2e-3), 1.0), solimp=(0.95, 0.99, 0.001, 0.5, 2.0), stick=10.0, solver="newton",
        iterations=100, line_search=50,
    )  # fmt: skip
    limit = np.where(np.isfinite(robot.torque_limit), robot.torque_limit, _UNLIMITED)
    return Mujoco(
        robot, timestep=timestep, action=torques(half_range=limit), contact=contact, friction=friction,
        terrain=ground, body_collisions=True,
    )  # fmt: skip


def run_policy(
    policy: Policy, plant: Mujoco, initial: ArrayLike | None = None, *, control: Control | None = None
) -> PolicyRun:
    """Simulate a policy from the plan's start to the plan's end, or until the plan is lost.

    The control is computed at every step of the simulator.

    Args:
        policy: the policy.
        plant: the robot with torques as controls, as :func:`torque_plant` returns it.
        initial: first state of the plant (nx,); by default the plan's.
        control: a low-level controller of the same plan, in place of ū + K (x ⊖ x̄).
    """
    return play(sampled(policy, plant.timestep), plant, policy.initial if initial is None else initial, control)


def _errors(deviation: Array, robot: Robot) -> tuple[float, float]:
    """Return the errors of position and orientation of a state, see :class:`PolicyRun`."""
    if robot.base == "fixed":
        return 0.0, float(np.abs(deviation[: robot.num_joints]).max())
    return float(np.linalg.norm(deviation[:3])), float(np.linalg.norm(deviation[3:6]))


class Steps(NamedTuple):
    """A policy at the steps of a simulator: u = ū + K (x ⊖ x̄), with T steps.

    Attributes:
        policy: the policy.
        times: (T,) [s].
        phases: index of the phase, (T,). stages: index of the stage in the phase, (T,).
        states: x̄ (T, nx).
    """

    policy: Policy
    times: Array
    phases: NDArray[np.int_]
    stages: NDArray[np.int_]
    states: Array


def sampled(policy: Policy, timestep: float) -> Steps:
    """Return a policy at the steps of a simulator [s]; several runs of it share this work."""
    count = round((policy.end - policy.start) / timestep) + 1
    times = np.array([policy.start + timestep * i for i in range(count)])
    plans = [policy.planned(float(t)) for t in times]
    return Steps(
        policy, times, np.array([plan.phase for plan in plans]), np.array([plan.stage for plan in plans]),
        np.array([plan.state for plan in plans]),
    )  # fmt: skip


def play(steps: Steps, plant: Mujoco, initial: ArrayLike, control: Control | None = None) -> PolicyRun:
    """Simulate a sampled policy, or another controller of its plan, from a state (nx,), see :func:`run_policy`."""
    policy, limits = steps.policy, plant.robot.torque_limit[list(plant.robot.motors)]
    simulated = Simulation(plant, np.array(initial, dtype=float))
    states, forces, slips, touching, errors, full = [], [], [], [], [], []
    lost = None
    for t, phase, stage, planned in zip(steps.times, steps.phases, steps.stages, steps.states, strict=True):
        part, x = policy.trajectory.phases[phase], simulated.state
        deviation = part.state.np_minus(x, planned)
        errors.append(_errors(deviation, plant.robot))
        states.append(x)
        forces.append(simulated.foot_forces())
        slips.append(simulated.foot_slip())
        touching.append(simulated.others_in_contact())
        feedback = policy.feedback[phase][stage]
        u = part.controls[stage] + feedback @ deviation if control is None else control(x, float(t))
        full.append(np.abs(u) >= limits)
        if simulated.failed or errors[-1][0] > LOST_M or errors[-1][1] > LOST_RAD:
            lost = float(t)
            break
        simulated.step(u)
    table, n = np.array(errors), len(errors)
    return PolicyRun(
        times=steps.times[:n], states=np.array(states), planned=steps.states[:n], phases=steps.phases[:n],
        forces=np.array(forces), slips=np.array(slips), touching=tuple(touching), position=table[:, 0],
        orientation=table[:, 1], full=np.array(full), lost_at=lost, duration=policy.end - policy.start,
        saturated=float(np.mean(np.any(full, axis=1))),
    )  # fmt: skip
