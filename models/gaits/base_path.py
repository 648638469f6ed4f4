"""The path of the base in the plane: velocities that ramp to a command, and their integral."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import SAME_TIME

Array = NDArray[np.float64]

# Twelve Gauss points integrate a ramp with up to half a turn of yaw with an error below 1e-10.
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(12)


@dataclass(frozen=True, eq=False)
class BasePath:
    """The reference path of the base in the plane, for times with any leading axes.

    Velocities (forward, left) and the yaw rate change linearly from ``first`` to ``last`` within the ramp, and are
    constant after it.

    Args:
        origin: x, y [m] and yaw [rad] at time 0.
        first: forward and left velocity [m/s] and yaw rate [rad/s] at time 0, (3,).
        last: the same after the ramp, (3,).
        ramp: length of the ramp [s].
    """

    origin: tuple[float, float, float]
    first: Array
    last: Array
    ramp: float

    def command(self, t: Array) -> Array:
        """Return forward and left velocity [m/s] and yaw rate [rad/s], (..., 3)."""
        return self.first + self._progress(t)[..., None] * (self.last - self.first)

    def yaw(self, t: Array) -> Array:
        """Return the yaw angle, full turns included [rad]."""
        t = np.maximum(t, 0.0)
        within = np.minimum(t, self.ramp)
        mean = self.first[2] + 0.5 * (self._progress(within) if self.ramp else 0.0) * (self.last[2] - self.first[2])
        return np.asarray(self.origin[2] + mean * within + self.last[2] * (t - within))

    def position(self, t: Array) -> Array:
        """Return x and y, the integral of the velocity, (..., 2) [m]."""
        t = np.maximum(t, 0.0)
        within = np.minimum(t, self.ramp)
        nodes = within[..., None] * (_POINTS + 1) / 2
        ramped = np.sum(self.velocity(nodes) * (_WEIGHTS / 2)[:, None], axis=-2) * within[..., None]
        # after the ramp an arc of a circle: the integral of R(ω s) ds is [sin, cos − 1; 1 − cos, sin] / ω
        after, turn = t - within, self.last[2] * (t - within)
        along = after * np.sinc(turn / np.pi)
        across = after * np.sinc(turn / (2 * np.pi)) * np.sin(turn / 2)
        forward, leftward = self.last[0], self.last[1]
        arc = np.stack([along * forward - across * leftward, across * forward + along * leftward], axis=-1)
        return np.asarray(np.array(self.origin[:2]) + ramped + turn_by(self.yaw(within), arc))

    def velocity(self, t: Array) -> Array:
        """Return the velocity in world axes, (..., 2) [m/s]."""
        return turn_by(self.yaw(t), self.command(t)[..., :2])

    def acceleration(self, t: Array) -> Array:
        """Return the acceleration in heading axes, centripetal acceleration included, (..., 2) [m/s^2]."""
        command = self.command(t)
        ramping = ((t < self.ramp - SAME_TIME) / self.ramp if self.ramp else 0.0 * t)[..., None] * (
            self.last - self.first
        )[:2]
        turning = command[..., 2:] * np.stack([-command[..., 1], command[..., 0]], axis=-1)
        return np.asarray(ramping + turning)

    def _progress(self, t: Array) -> Array:
        return np.clip(t / self.ramp, 0.0, 1.0) if self.ramp else np.ones_like(t)


def turn_by(angle: Array, vectors: Array) -> Array:
    """Return vectors in the plane, (..., 2), rotated by angles (...) [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def ease(t: Array, length: float, first: Array, last: Array) -> tuple[Array, Array]:
    """Return values, and their rates, of a cubic from ``first`` to ``last`` that is at rest at both ends.

    Args:
        t: times, (S,) [s].
        length: duration [s]; 0 for a step at time 0.
        first: (k,).
        last: (k,).
    """
    s = np.clip(t / length, 0.0, 1.0)[..., None] if length else np.ones((*np.shape(t), 1))
    rate = 6 * s * (1 - s) / length if length else np.zeros_like(s)
    return first + s**2 * (3 - 2 * s) * (last - first), rate * (last - first)
