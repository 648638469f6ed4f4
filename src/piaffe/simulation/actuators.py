"""Actuators of a plant: rotor inertia, damping, dry friction, limits of torque and speed, and a delay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.models import Robot, per_joint

from .numbers import finite_number, whole_steps

Array = NDArray[np.float64]

_NUMBERS = {"armature": True, "damping": True, "friction": True, "torque_limit": False, "stall_torque": False}
"""Fields with a number per joint that may be None, and whether it must be finite."""


@dataclass(frozen=True, kw_only=True)
class Actuators:
    """What stands between a commanded torque and a joint.

    A torque within ± ``torque_limit`` acts. In the direction of motion it is also at most::

        stall_torque · (1 − |q̇| / no_load_speed),   not less than 0

    because the motor induces a voltage against the supply's; a torque against the motion has no such limit.
    Damping and dry friction act on the joint, outside these limits.

    Each is one number for all joints, one number per joint, or a mapping from labels that names every joint. None
    stands for the number of the plant's model: that of the robot, or of the MJCF file; a model without one has no
    damping, no friction and no limit.

    Args:
        armature: rotor inertia reflected to the joints [kg m²].
        damping: viscous damping [Nm s/rad].
        friction: dry friction [Nm].
        torque_limit: largest torque [Nm].
        stall_torque: torque that the supply's voltage allows at rest [Nm]; None is the torque limit.
        no_load_speed: joint speed at which the induced voltage is the supply's [rad/s].
        delay: time from a command to its torque [s], whole steps of the simulator.

    Raises:
        ModelError: a number is negative, or not a number.
    """

    armature: Any = None
    damping: Any = None
    friction: Any = None
    torque_limit: Any = None
    stall_torque: Any = None
    no_load_speed: Any = np.inf
    delay: float = 0.0

    def __post_init__(self) -> None:
        if finite_number("actuators", "delay", self.delay) < 0:
            raise ModelError(f"actuators: delay is out of range - got {self.delay!r}, expected seconds ≥ 0; change it")

    def number(self, name: str, robot: Robot) -> Array | None:
        """Return a field of ``Actuators`` for the joints of a robot, (n,); None if it is not given.

        Raises:
            ModelError: a number is missing, negative or not a number.
        """
        value = getattr(self, name)
        if value is None:
            return None
        return per_joint(robot, f"actuators, {name}", value, finite=_NUMBERS.get(name, False))


def mini_cheetah_actuators() -> Actuators:
    """Return the published actuators of Mini Cheetah, those of its simulator [Li2025CafeMpc].

    Motors have a torque constant of 0.05 Nm/A, a resistance of 0.173 Ω and gear ratios of 6, 6 and 9.33 at 24 V. The
    current for a torque is τ / (1.5 · 0.05 · ratio), the induced voltage 2 · 0.05 · ratio · q̇. A board limits torques.
    The armature is the robot's; load it with ``rotors=True``.
    """
    ratio = np.array([6.0, 6.0, 9.33])
    volt, ohm, constant = 24.0, 0.173, 0.05
    return Actuators(
        damping=0.01,
        friction=0.2,
        torque_limit={"HAA": 17.0, "HFE": 17.0, "KFE": 26.0},
        stall_torque=dict(zip(("HAA", "HFE", "KFE"), 1.5 * constant * ratio * volt / ohm, strict=True)),
        no_load_speed=dict(zip(("HAA", "HFE", "KFE"), volt / (2 * constant * ratio), strict=True)),
    )


class Drive:
    """Actuators at work: delays commands and limits torques.

    Args:
        torque_limit: (n,) [Nm]. stall_torque: (n,) [Nm]. no_load_speed: (n,) [rad/s].
        delay: in steps of the simulator.
    """

    def __init__(self, torque_limit: Array, stall_torque: Array, no_load_speed: Array, delay: int) -> None:
        self.torque_limit, self._stall, self._no_load = torque_limit, stall_torque, no_load_speed
        self._queue: list[Array] = []
        self._delay = delay

    @staticmethod
    def of(actuators: Actuators, robot: Robot, torque_limit: Array, timestep: float) -> Drive:
        """Return the drive of actuators; the torque limit is that of the plant's model."""
        own = actuators.number("torque_limit", robot)
        limit = torque_limit if own is None else own
        stall, speed = actuators.number("stall_torque", robot), actuators.number("no_load_speed", robot)
        assert speed is not None  # it has a default
        delay = whole_steps("actuators", "delay", actuators.delay, timestep)
        return Drive(limit, limit if stall is None else stall, speed, delay)

    def __call__(self, command: Array, speed: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the torques that act in this step, and which of the commands exceeded a limit.

        Before the first command has passed the delay, it acts at once, as nothing was commanded before.

        Args:
            command: commanded torques (n,) [Nm].
            speed: of the joints (n,) [rad/s].
        """
        if self._delay:
            self._queue.append(command)
            command = self._queue.pop(0) if len(self._queue) > self._delay else self._queue[0]
        with np.errstate(invalid="ignore"):  # ∞ · 0 of a joint without limits
            share = np.maximum(1.0 - np.abs(speed) / self._no_load, 0.0)
            driving = np.where(np.isfinite(self._stall), self._stall * share, self._stall)
        most = np.minimum(self.torque_limit, driving)
        upper = np.where(speed > 0, most, self.torque_limit)
        lower = np.where(speed < 0, -most, -self.torque_limit)
        acting = np.minimum(np.maximum(command, lower), upper)
        return acting, (command >= upper) | (command <= lower)
