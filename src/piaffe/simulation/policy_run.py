"""Playing a policy in MuJoCo, which simulates the contacts instead of prescribing them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.models import Mujoco, Robot, SoftContact, torques

from .plant import Plant
from .policy import Policy

Array = NDArray[np.float64]

LOST_M, LOST_RAD = 0.3, 1.0
"""Further from the plan than this, in position or orientation of the base, it is no longer followed."""


@dataclass(frozen=True, eq=False)
class PolicyRun:
    """What a policy did in simulation, at T steps of the simulator.

    Args:
        times: (T,) [s].
        states: of the plant (T, nx).
        planned: states of the plan (T, nx).
        phases: index of the plan's phase, (T,).
        forces: on the feet in world axes, (T, nf, 3) [N]: of the step that led to the state.
        position: error of the base (T,) [m]. orientation: likewise [rad].
        lost_at: when the plan was lost [s], None if it was followed to its end.
        duration: of the plan [s].
        saturated: share of the steps at which some torque was at its limit.
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
            f"simulation {how}; base off by at most {self.position.max():.3f} m and {self.orientation.max():.3f} rad, "
            f"at last {self.position[-1]:.3f} m and {self.orientation[-1]:.3f} rad; torque limits reached in "
            f"{100 * self.saturated:.0f} % of the steps"
        )


def torque_plant(robot: Robot, *, timestep: float = 1e-3, friction: float = 0.6) -> Mujoco:
    """Return a robot with torques as controls and feet that give less than MuJoCo's default.

    Args:
        robot: the robot.
        timestep: of the simulator [s].
        friction: sliding friction coefficient of the feet.
    """
    contact = SoftContact(
        solref=(max(4 * timestep, 2e-3), 1.0), solimp=(0.95, 0.99, 0.001, 0.5, 2.0), stick=10.0, solver="newton",
        iterations=100, line_search=50,
    )  # fmt: skip
    return Mujoco(robot, timestep=timestep, action=torques(), contact=contact, friction=friction)


def run_policy(policy: Policy, plant: Mujoco) -> PolicyRun:
    """Play a policy from the plan's first state, at every step of the simulator, to the plan's end or until it is lost.

    Args:
        policy: the policy.
        plant: the robot, with torques as controls, as :func:`torque_plant` makes it.
    """
    simulated, limits = Plant(plant, policy.initial), plant.robot.torque_limit
    times, states, planned, phases, forces, errors = [], [], [], [], [], []
    lost, full = None, 0
    for step in range(round((policy.end - policy.start) / plant.timestep) + 1):
        t, x = policy.start + step * plant.timestep, simulated.state
        wanted = policy.planned(t)
        off = wanted.part.state.np_minus(x, wanted.state)
        errors.append((float(np.linalg.norm(off[:3])), float(np.linalg.norm(off[3:6]))))
        times.append(t)
        states.append(x)
        planned.append(wanted.state)
        phases.append(wanted.phase)
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
