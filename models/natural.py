"""Natural sizes of a robot's lengths, times, masses, forces, torques and speeds: the units in which a solve counts.

Quadrupeds of 1.4 to 49 kilograms count in SI units. A smaller or larger robot, as ANYmal C, has sizes of its own,
relative to those of Mini Cheetah. So tolerances, barriers and regularisation mean for it what they mean for the others.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from piaffe.ocp import Sizes

_LENGTH, _MASS, _TORQUE, _SPEED = 0.209, 8.252, 17.0, 20.0  # of Mini Cheetah: [m], [kg], [Nm], [rad/s]
_GRAVITY = 9.81  # [m/s²]
_USUAL_SIZE, _USUAL_LIMIT = 6.0, 8.0  # factors to Mini Cheetah's: of length and mass; of torques and speeds


def sizes(robot: Any) -> Sizes:
    """Return the natural sizes of a robot: 1 in SI units if both its length and its mass are usual.

    The length is the longest distance of two joints, relative to Mini Cheetah's; the mass likewise. The time is the
    square root of the length over gravity, also relative. They are usual if they are within a factor of six.
    """
    places = [place.translation for place in robot.model.jointPlacements]
    length = max((float(np.linalg.norm(place)) for place in places), default=0.0) / _LENGTH
    mass = float(robot.mass) / _MASS
    if not (0 < length < np.inf and 0 < mass < np.inf) or (
        _is_usual(length, _USUAL_SIZE) and _is_usual(mass, _USUAL_SIZE)
    ):
        return Sizes()
    gravity = float(np.linalg.norm(robot.model.gravity.linear)) / _GRAVITY
    return Sizes(length=length, time=(length / (gravity or 1.0)) ** 0.5, mass=mass)


def force(model: Any) -> float:
    """Return the unit of contact forces [N]."""
    return float(model.sizes.of("N"))


def impulse(model: Any) -> float:
    """Return the unit of impulses [N s]: the mass times 0.1 m/s, or another speed for a robot that is not usual."""
    return 0.1 * float(model.robot.mass) * float(model.sizes.of("m/s"))


def length(model: Any) -> float:
    """Return the unit of heights [m]."""
    return float(model.sizes.of("m"))


def torque(model: Any) -> float:
    """Return the unit of joint torques [Nm]: for a robot that is not usual its largest, relative to 17 Nm."""
    return _of_limits(model, model.robot.torque_limit, _TORQUE, "Nm")


def speed(model: Any) -> float:
    """Return the unit of joint speeds [rad/s]: for a robot that is not usual its largest, relative to 20 rad/s."""
    return _of_limits(model, model.robot.joint_speed_limit, _SPEED, "rad/s")


def _of_limits(model: Any, limits: Any, usual: float, unit: str) -> float:
    finite = np.asarray(limits, dtype=float)[np.isfinite(limits)]
    ratio = float(np.max(finite, initial=0.0)) / usual
    if not ratio > 0:
        return float(model.sizes.of(unit))
    return 1.0 if model.sizes == Sizes() and _is_usual(ratio, _USUAL_LIMIT) else ratio


def _is_usual(ratio: float, factor: float) -> bool:
    return 1 / factor < ratio < factor
