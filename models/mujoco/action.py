"""Actions: the control inputs of a simulated robot, which are joint targets of a PD law, or torques."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.ocp import Quantity

from ..mujoco_import import import_mujoco
from ..per_joint import per_joint
from ..quantities import joints
from ..robot import Robot

Array = NDArray[np.float64]

ERROR_AT_LIMIT = 0.675
"""Angle error at which the default stiffness commands the torque limit [rad]."""
DAMPING_TIME = 0.05
"""Ratio of the default damping to the stiffness [s]."""


@dataclass(frozen=True, eq=False)
class BoundAction:
    """The action of one robot with n joints that have motors; it has n controls.

    Args:
        quantity: the quantity that the controls are, ``joints.target`` or ``joints.torque``.
        centre: middle of the range of the controls, (n,) [rad] or [Nm].
        half_range: half of the range, (n,).
        kp: stiffness, (n,) [Nm/rad]; zero if controls are torques.
        kd: damping, (n,) [Nm s/rad].
    """

    quantity: Quantity
    centre: Array
    half_range: Array
    kp: Array
    kd: Array

    @property
    def lower(self) -> Array:
        """Smallest control, (n,)."""
        return self.centre - self.half_range

    @property
    def upper(self) -> Array:
        """Largest control, (n,)."""
        return self.centre + self.half_range

    def torque(self, u: Any, q: Any, v: Any) -> Any:
        """Return the commanded torque before limits, kp (u − q) − kd v for joint targets and u for torques [Nm].

        Args:
            u: control, CasADi (n, 1) or NumPy (..., n).
            q: joint angles [rad].
            v: joint velocities [rad/s].
        """
        return self.kp * (u - q) - self.kd * v if self.quantity == joints.target else u

    def add_to(self, spec: Any, robot: Robot) -> None:
        """Add an actuator for each joint, in state order; its control is the action's, its force is limited."""
        mujoco = import_mujoco()
        limits = robot.torque_limit[list(robot.motors)]
        for i, (name, limit) in enumerate(zip(robot.motor_names, limits, strict=True)):
            motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.set_to_motor()
            if self.quantity == joints.target:
                motor.gainprm[0] = self.kp[i]
                motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
                motor.biasprm[:3] = (0.0, -self.kp[i], -self.kd[i])
            if np.isfinite(limit):
                motor.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
                motor.forcerange = (-limit, limit)


class Action(ABC):
    """A declared action; :meth:`bind` makes it the action of one robot."""

    @abstractmethod
    def bind(self, robot: Robot) -> BoundAction:
        """Return the action of a robot.

        Raises:
            ModelError: a number is missing, or out of range.
        """


@dataclass(frozen=True, eq=False)
class JointTargets(Action):
    """Target angles of a PD law; made by :func:`joint_targets`."""

    kp: Any
    kd: Any
    centre: object
    half_range: Any

    def bind(self, robot: Robot) -> BoundAction:
        """Return the action of a robot."""
        passive = [name for name in robot.joint_names if name not in robot.motor_names]
        if passive:
            raise ModelError(
                f"joint_targets: robot '{robot.name}' has joints without a motor - got {passive}, expected none; use "
                "models.torques(), or give limits with dataclasses.replace(robot, torque_limit=...)"
            )
        wanted = robot.torque_limit / ERROR_AT_LIMIT if self.kp is None else self.kp
        kp = per_joint(robot, "joint_targets, kp", wanted)
        kd = per_joint(robot, "joint_targets, kd", DAMPING_TIME * kp if self.kd is None else self.kd)
        half = per_joint(robot, "joint_targets, half_range", self.half_range)
        return BoundAction(joints.target, robot.pose(self.centre), half, kp, kd)


@dataclass(frozen=True, eq=False)
class Torques(Action):
    """Joint torques, constant for a step of the simulator; made by :func:`torques`."""

    half_range: Any

    def bind(self, robot: Robot) -> BoundAction:
        """Return the action of a robot."""
        half = per_joint(
            robot, "torques, half_range", robot.torque_limit if self.half_range is None else self.half_range
        )
        motors = list(robot.motors)
        return BoundAction(joints.torque, np.zeros(len(motors)), half[motors], *np.zeros((2, len(motors))))


def joint_targets(kp: Any = None, kd: Any = None, *, centre: object = "stand", half_range: Any = 0.4) -> JointTargets:
    """Return an action whose controls are target angles of a PD law, evaluated at every step of the simulator.

    The torque is kp (target − q) − kd q̇, within the robot's limits. Each argument is one number for all joints, one
    number per joint, or a mapping from labels, ``{"HAA": 0.3, "HFE": 0.4}``, that names every joint.

    Args:
        kp: stiffness; by default the torque limit divided by 0.675 rad, which is 4 for Solo12 [Nm/rad].
        kd: damping; by default 0.05 s times the stiffness [Nm s/rad].
        centre: middle of the range of the targets: a pose's name, n numbers or a mapping from labels [rad].
        half_range: half of the range [rad]; samplers draw targets within it.
    """
    return JointTargets(kp, kd, centre, half_range)


def torques(half_range: Any = None) -> Torques:
    """Return an action whose controls are joint torques.

    Args:
        half_range: samplers draw torques within ± this; numbers as for :func:`joint_targets` [Nm]. By default the
            robot's limits.
    """
    return Torques(half_range)
