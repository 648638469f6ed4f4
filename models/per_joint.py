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


def per_joint(robot: Robot, where: str, value: Any) -> Array:
    """Return one number per joint, (n,), from a number, n numbers, or a mapping from labels that names every joint.

    Raises:
        ModelError: a number is missing, not finite or negative.
    """
    numbers: Array = np.full(robot.num_joints, np.nan)
    if isinstance(value, Mapping):
        for label, entry in value.items():
            numbers[match_labels(robot.joint_names, label, f"{where} of '{robot.name}'")] = entry
    else:
        with suppress(TypeError, ValueError):
            numbers[:] = np.asarray(value, dtype=float)
    for name, number in zip(robot.joint_names, numbers, strict=True):
        if not (np.isfinite(number) and number >= 0):
            raise ModelError(
                f"{where} of '{robot.name}': no number for joint '{name}' - got {value!r}, expected one number, "
                f"{robot.num_joints} numbers or a mapping from labels that names every joint, each finite and ≥ 0; "
                "give them"
            )
    return numbers
