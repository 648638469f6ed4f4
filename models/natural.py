"""Natural sizes of a robot's forces, torques, speeds and lengths, by which rows of constraints are divided.

Quadrupeds of a few to a hundred kilograms count in SI units: their sizes are within a factor of eight of those below.
A robot that is a thousand times lighter or heavier has sizes of its own, so that tolerances and barriers mean for it
what they mean for the others.
"""

from __future__ import annotations

from typing import Any

import numpy as np

_FORCE, _TORQUE, _SPEED, _LENGTH = 100.0, 20.0, 20.0, 0.25  # of a small quadruped: [N], [Nm], [rad/s], [m]
_GRAVITY = 9.81  # [m/s²]
_USUAL = 8.0


def force(model: Any) -> float:
    """Return the unit of contact forces [N], a hundredth of the weight; 1 for robots of the usual size."""
    return _unit(float(model.robot.mass) * _GRAVITY / _FORCE)


def torque(model: Any) -> float:
    """Return the unit of joint torques [Nm], a twentieth of the largest; 1 for robots of the usual size."""
    return _unit(_largest(model.robot.torque_limit) / _TORQUE)


def speed(model: Any) -> float:
    """Return the unit of joint speeds [rad/s], a twentieth of the largest; 1 for robots of the usual size."""
    return _unit(_largest(model.robot.joint_speed_limit) / _SPEED)


def length(model: Any) -> float:
    """Return the unit of heights [m], four times the longest distance of joints; 1 for robots of the usual size."""
    places = [place.translation for place in model.robot.model.jointPlacements]
    return _unit(max((float(np.linalg.norm(place)) for place in places), default=_LENGTH) / _LENGTH)


def _largest(limits: Any) -> float:
    finite = np.asarray(limits, dtype=float)[np.isfinite(limits)]
    return float(np.max(finite, initial=0.0))


def _unit(ratio: float) -> float:
    return 1.0 if not 0 < ratio < np.inf or 1 / _USUAL < ratio < _USUAL else ratio
