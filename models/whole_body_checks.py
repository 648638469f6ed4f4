"""Checks of the arguments of a whole body."""

from __future__ import annotations

import numpy as np

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
