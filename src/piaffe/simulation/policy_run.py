"""Simulation of a policy in MuJoCo; contacts are simulated, not prescribed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.models import Mujoco, Robot, SoftContact, torques
from piaffe.ocp import Policy

from .plant import Plant

Array = NDArray[np.float64]

_UNLIMITED = 1e6  # [Nm]: the range of a control needs a number; the actuator of such a joint has no limit

LOST_M, LOST_RAD = 0.3, 1.0
"""The plan is lost if the error of the base exceeds this, in position or in orientation."""


@dataclass(frozen=True, eq=False)
class PolicyRun:
    """The record of a simulated policy, at T steps of the simulator.

    Args:
        times: (T,) [s].
        states: states of the plant (T, nx).
        planned: states of the plan (T, nx).
        phases: index of the plan's phase, (T,).
        forces: forces on the feet in world axes (T, nf, 3) [N], in the step before each state.
        position: position error of the base (T,) [m]. orientation: its orientation error (T,) [rad].
        lost_at: time at which the plan was lost [s]; None if it was followed to its end.
        duration: duration of the plan [s].
        saturated: fraction of the steps at which a torque was at its limit.
    """

    times: Array
    states: Array
    planned: Array
    phases: NDArray[np.int_]
    forces: Array
    position: Array
    orientation: Array
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


def torque_plant(robot: Robot, *, timestep: float = 1e-3, friction: float = 0.6) -> Mujoco:
    """Return a robot with torques as controls and with stiffer contacts than MuJoCo's default.

    Args:
        robot: the robot.
        timestep: time step of the simulator [s].
        friction: sliding friction coefficient of the feet.
    """
    contact = SoftContact(
        solref=(max(4 * timestep, 2e-3), 1.0), solimp=(0.95, 0.99, 0.001, 0.5, 2.0), stick=10.0, solver="newton",
        iterations=100, line_search=50,
    )  # fmt: skip
    limit = np.where(np.isfinite(robot.torque_limit), robot.torque_limit, _UNLIMITED)
    return Mujoco(robot, timestep=timestep, action=torques(half_range=limit), contact=contact, friction=friction)


def run_policy(policy: Policy, plant: Mujoco) -> PolicyRun:
    """Simulate a policy from the plan's first state to the plan's end, or until the plan is lost.

    The control is computed at every step of the simulator.

    Args:
        policy: the policy.
        plant: the robot with torques as controls, as :func:`torque_plant` returns it.
    """
    simulated, limits = Plant(plant, policy.initial), plant.robot.torque_limit
    times, states, planned, phases, forces, errors = [], [], [], [], [], []
    lost, full = None, 0
    for step in range(round((policy.end - policy.start) / plant.timestep) + 1):
        t, x = policy.start + step * plant.timestep, simulated.state
        plan = policy.planned(t)
        deviation = plan.part.state.np_minus(x, plan.state)
        errors.append((float(np.linalg.norm(deviation[:3])), float(np.linalg.norm(deviation[3:6]))))
        times.append(t)
        states.append(x)
        planned.append(plan.state)
        phases.append(plan.phase)
        forces.append(simulated.foot_forces())
        if simulated.failed or errors[-1][0] > LOST_M or errors[-1][1] > LOST_RAD:
            lost = t
            break
        u = policy.control(x, t)
        full += bool(np.any(np.abs(u) >= limits))
        simulated.step(u)
    table = np.array(errors)
    return PolicyRun(
        np.array(times), np.array(states), np.array(planned), np.array(phases), np.array(forces), table[:, 0],
        table[:, 1], lost, policy.end - policy.start, full / len(errors),
    )  # fmt: skip
