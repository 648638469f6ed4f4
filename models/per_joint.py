"""One number per joint, from one number for all, n numbers, or a mapping from labels."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.ocp import match_labels

from .robot import Robot

Array = NDArray[np.float64]


def per_joint(robot: Robot, where: str, value: Any, *, finite: bool = True) -> Array:
    """Return one number ≥ 0 per joint, (n,), from a number, n numbers, or a mapping from labels that names every joint.

    Args:
        robot: the robot.
        where: the beginning of the error's text.
        value: the numbers.
        finite: whether infinity is refused.

    Raises:
        ModelError: a number is missing, negative or not a number.
    """
    numbers: Array = np.full(robot.num_joints, np.nan)
    if isinstance(value, Mapping):
        for label, entry in value.items():
            numbers[match_labels(robot.joint_names, label, f"{where} of '{robot.name}'")] = entry
    else:
        with suppress(TypeError, ValueError):
            numbers[:] = np.asarray(value, dtype=float)
    for name, number in zip(robot.joint_names, numbers, strict=True):
        if np.isnan(number) or number < 0 or (finite and np.isinf(number)):
            raise ModelError(
                f"{where} of '{robot.name}': no number for joint '{name}' - got {value!r}, expected one number, "
                f"{robot.num_joints} numbers or a mapping from labels that names every joint, each "
                f"{'finite and ' if finite else ''}≥ 0; give them"
            )
    return numbers
