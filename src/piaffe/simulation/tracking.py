"""How a base follows its commanded velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import rotation

Array = NDArray[np.float64]

_LEAST = 0.5  # [s]: the mean velocity of less than a cycle says little


@dataclass(frozen=True)
class Tracking:
    """Means over a stretch of an episode; the axes are those of the heading.

    Args:
        velocity: mean velocity of the base ahead and to the left [m/s].
        commanded: mean of the commanded velocity [m/s]; NaN if there is no command.
        yaw_rate: mean yaw rate [rad/s].
        commanded_yaw_rate: its command [rad/s].
        rms_velocity: root of the mean square of velocity minus command [m/s].
    """

    velocity: tuple[float, float]
    commanded: tuple[float, float]
    yaw_rate: float
    commanded_yaw_rate: float
    rms_velocity: float

    @property
    def speed(self) -> float:
        """Mean velocity in the direction of the commanded one; without a command, or at rest, its norm [m/s]."""
        size = float(np.hypot(*self.commanded))
        if not size > 0:
            return float(np.hypot(*self.velocity))
        return float(np.dot(self.velocity, self.commanded)) / size

    @property
    def speed_error(self) -> float:
        """Absolute difference of speed and commanded speed, relative to the latter; NaN without a commanded motion."""
        size = float(np.hypot(*self.commanded))
        return abs(self.speed - size) / size if size > 0 else float("nan")

    @property
    def yaw_rate_error(self) -> float:
        """Absolute difference of mean yaw rate and command [rad/s]; NaN without a command."""
        return abs(self.yaw_rate - self.commanded_yaw_rate)


def heading(orientations: Array) -> Array:
    """Return the yaw angles of unit quaternions (T, 4), full turns included, (T,) [rad]."""
    matrix = rotation.np_matrix(orientations)
    return np.asarray(np.unwrap(np.arctan2(matrix[:, 1, 0], matrix[:, 0, 0])))


def in_heading(yaw: Array, velocities: Array) -> Array:
    """Return velocities ahead and to the left, (T, 2), of velocities in world axes (T, 3)."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = velocities[:, 0], velocities[:, 1]
    return np.stack([c * x + s * y, c * y - s * x], axis=1)


def stretches(times: Array, commands: Array, settle: float) -> list[slice]:
    """Return where the command is constant, each without its beginning; those shorter than 0.5 s are left out.

    Args:
        times: (T,) [s].
        commands: (T, 3); NaN if there is none.
        settle: time that is left out after each change of the command [s].
    """
    if not len(times) or not np.all(np.isfinite(commands)):
        return []
    begins = np.flatnonzero(np.append(True, np.any(np.diff(commands, axis=0) != 0, axis=1)))
    found = []
    for first, end in zip(begins, [*begins[1:], len(times)], strict=True):
        settled = int(np.searchsorted(times, times[first] + settle - 1e-9))
        if settled < end and times[end - 1] - times[settled] >= _LEAST - 1e-9:
            found.append(slice(settled, end))
    return found


def tracked(times: Array, yaw: Array, velocity: Array, commands: Array) -> Tracking:
    """Return the means of a stretch.

    Args:
        times: (T,) [s].
        yaw: (T,) [rad].
        velocity: in heading axes (T, 2) [m/s].
        commands: velocity ahead and to the left, yaw rate (T, 3).
    """
    elapsed = float(times[-1] - times[0])
    mean, asked = velocity.mean(axis=0), commands.mean(axis=0)
    return Tracking(
        velocity=(float(mean[0]), float(mean[1])),
        commanded=(float(asked[0]), float(asked[1])),
        yaw_rate=float(yaw[-1] - yaw[0]) / elapsed if elapsed > 0 else float("nan"),
        commanded_yaw_rate=float(asked[2]),
        rms_velocity=float(np.sqrt(np.mean(np.sum((velocity - commands[:, :2]) ** 2, axis=1)))),
    )
