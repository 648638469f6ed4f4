"""Checked numbers: what a user gives for a robot's joints, and durations in whole steps."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.models import Robot
from piaffe.ocp import is_same_time, match_labels

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


def whole_steps(where: str, what: str, seconds: Any, step: float, *, least: int = 0) -> int:
    """Return a duration as a number of steps.

    Args:
        where: the beginning of the error's text.
        what: name of the duration.
        seconds: the duration [s].
        step: duration of a step [s].
        least: the smallest number of steps.

    Raises:
        ModelError: the duration is not a number, or no whole number of steps, or too short.
    """
    count = finite_number(where, what, seconds) / step
    if round(count) < least or not is_same_time(round(count) * step, seconds):
        limit = f", at least {least * step:g} s" if least else ", at least 0 s"
        raise ModelError(
            f"{where}: {what} is out of range - got {seconds:g} s, expected a multiple of {step:g} s{limit}; change it"
        )
    return round(count)


def finite_number(where: str, what: str, value: Any) -> float:
    """Return a number as a float; raise ModelError if it is not a finite number."""
    with suppress(TypeError, ValueError):
        if not isinstance(value, bool | str) and np.isfinite(float(value)):
            return float(value)
    raise ModelError(f"{where}: {what} is not a number - got {value!r}, expected a finite number; give one")


def vector(where: str, what: str, value: Any) -> tuple[float, float, float]:
    """Return three finite numbers; raise ModelError if these are not."""
    with suppress(TypeError, ValueError):
        x, y, z = np.asarray(value, dtype=float)
        if np.all(np.isfinite((x, y, z))):
            return float(x), float(y), float(z)
    raise ModelError(f"{where}: {what} is not a vector - got {value!r}, expected x, y, z, finite numbers; give three")
