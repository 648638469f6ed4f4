"""Checked numbers: durations in whole steps, single numbers and vectors."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from piaffe.errors import ModelError
from piaffe.ocp import is_same_time


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
