"""Checks of the arguments of a whole body, and of the numbers that replace them as parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError

from .robot import Robot


def require_motors(robot: Robot) -> None:
    """Raise ModelError if all joints are passive: there is nothing to control."""
    if not robot.motors:
        raise ModelError(
            f"whole body of '{robot.name}': no joint has a motor - got a torque limit of zero for {robot.joint_names}, "
            "expected a positive one for at least one joint; correct effort in the URDF, or use "
            "dataclasses.replace(robot, torque_limit=...)"
        )


def check_numbers(
    robot: Robot, baumgarte: float | None, contact_damping: float | None, impact: str, friction_speed: float
) -> None:
    """Raise ModelError unless the arguments of a whole body are in range."""
    where = f"whole body of '{robot.name}'"
    if baumgarte is not None and not (isinstance(baumgarte, int | float | np.floating) and 0 <= baumgarte < np.inf):
        raise ModelError(
            f"{where}: baumgarte is out of range - got {baumgarte!r}, expected a finite number ≥ 0 [1/s]; change it"
        )
    if contact_damping is not None and not contact_damping > 0:
        raise ModelError(
            f"{where}: contact_damping is out of range - got {contact_damping}, expected a positive number [1/kg]; "
            "leave it out for rigid contacts"
        )
    if impact not in ("contact", "landing"):
        raise ModelError(f"{where}: impact is unknown - got {impact!r}, expected 'contact' or 'landing'; choose one")
    if not (isinstance(friction_speed, int | float | np.floating) and 0 < friction_speed < np.inf):
        raise ModelError(
            f"{where}: friction_speed is out of range - got {friction_speed!r}, expected a finite number > 0 [rad/s]; "
            "change it"
        )


def not_negative(values: NDArray[np.float64]) -> str:
    """Return what is expected of numbers that must not be negative; empty if they are usable."""
    return "" if np.all(values >= 0) else "numbers ≥ 0"


def masses(values: NDArray[np.float64]) -> str:
    """Return what is expected of the masses of links; empty if they are usable."""
    return "" if np.all(values >= 0) and values.sum() > 0 else "masses ≥ 0 [kg] with a positive sum"


SLOT_CHECKS: Mapping[str, Callable[[NDArray[np.float64]], str]] = {
    "link_mass": masses,
    **dict.fromkeys(
        ("foot_radius", "gamma", "contact_damping", "armature", "joint_damping", "joint_friction"), not_negative
    ),
}
"""Name of a slot → check of its values."""
