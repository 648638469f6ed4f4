"""How a base follows its commanded velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import rotation

Array = NDArray[np.float64]


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
