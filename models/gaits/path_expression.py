"""The base's path and posture from now on, as CasADi expressions; see :mod:`.base_path` for the same in NumPy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as cs
import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from piaffe.ocp import SAME_TIME

Array = NDArray[np.float64]


def _integral(nodes: Array) -> Array:
    """Return the matrix from values at Gauss points to the integral from −1, as coefficients of powers, (n + 1, n)."""
    n = len(nodes)
    values = np.linalg.inv(legendre.legvander(nodes, n - 1))
    return np.array([legendre.leg2poly(legendre.legint(column, lbnd=-1)) for column in values.T]).T


# The velocity within the ramp is interpolated at these points. With half a turn in the ramp, the error of the way is
# below 1e-11 of its length, with a full turn below 1e-7.
_NODES = legendre.leggauss(18)[0]
_INTEGRAL = _integral(_NODES)


@dataclass(frozen=True, eq=False)
class PathExpression:
    """The reference path of the base in the plane, at times after now.

    A path of :class:`.BasePath` goes on as a path of the same form from any later time, with the velocities of this
    time and what is left of the ramp. So the path after now needs no other time than now.

    Args:
        pose: x, y [m] and yaw [rad] now, (3, 1).
        first: forward and left velocity [m/s] and yaw rate [rad/s] now, (3, 1).
        last: the same after the ramp, (3, 1).
        ramp: what is left of the ramp [s].
    """

    pose: cs.SX
    first: cs.SX
    last: cs.SX
    ramp: cs.SX

    def command(self, t: cs.SX) -> cs.SX:
        """Return forward and left velocity [m/s] and yaw rate [rad/s], (3, 1)."""
        return self.first + progress(t, self.ramp) * (self.last - self.first)

    def yaw(self, t: cs.SX) -> cs.SX:
        """Return the yaw angle, full turns after now included [rad]."""
        t = cs.fmax(t, 0)
        within = cs.fmin(t, self.ramp)
        mean = self.first[2] + 0.5 * progress(within, self.ramp) * (self.last[2] - self.first[2])
        return self.pose[2] + mean * within + self.last[2] * (t - within)

    def position(self, t: cs.SX) -> cs.SX:
        """Return x and y, the integral of the velocity, (2, 1) [m]."""
        t = cs.fmax(t, 0)
        u, ramped = 2 * progress(t, self.ramp) - 1, cs.SX.zeros(2)
        for coefficient in reversed(self._way):
            ramped = coefficient + u * ramped
        # after the ramp an arc of a circle, whose chord is in the direction of its middle
        after = cs.fmax(t - self.ramp, 0)
        half = self.last[2] * after / 2
        return self.pose[:2] + ramped + turned(self.yaw(self.ramp) + half, after * _sinc(half) * self.last[:2])

    @cached_property
    def _way(self) -> list[cs.SX]:
        """Coefficients of the way within the ramp as a polynomial in u, which goes from −1 to 1 in it, (2, 1) each."""
        velocities = cs.horzcat(*(self.velocity(self.ramp * (node + 1) / 2) for node in _NODES))
        return cs.horzsplit(self.ramp / 2 * velocities @ _INTEGRAL.T)

    def velocity(self, t: cs.SX) -> cs.SX:
        """Return the velocity in world axes, (2, 1) [m/s]."""
        return turned(self.yaw(t), self.command(t)[:2])

    def acceleration(self, t: cs.SX) -> cs.SX:
        """Return the acceleration in heading axes, centripetal acceleration included, (2, 1) [m/s^2]."""
        command = self.command(t)
        ramping = (t < self.ramp - SAME_TIME) * (self.last - self.first)[:2] / cs.fmax(self.ramp, SAME_TIME)
        return ramping + command[2] * cs.vertcat(-command[1], command[0])

    def later(self, dt: cs.SX) -> PathExpression:
        """Return the same path from a later time on."""
        ramp, pose = self.ramp - dt, cs.vertcat(self.position(dt), self.yaw(dt))
        is_over = ramp < SAME_TIME
        return PathExpression(
            pose, cs.if_else(is_over, self.last, self.command(dt)), self.last, cs.if_else(is_over, 0, ramp)
        )


@dataclass(frozen=True, eq=False)
class EaseExpression:
    """A cubic from a value and its rate to a value at rest; one that :func:`.ease` returns goes on as such a cubic.

    Args:
        value: value now, (k, 1).
        rate: its rate now, (k, 1).
        last: value at the end, (k, 1).
        left: time until the end, (k, 1) [s].
    """

    value: cs.SX
    rate: cs.SX
    last: cs.SX
    left: cs.SX

    def at(self, t: cs.SX) -> tuple[cs.SX, cs.SX]:
        """Return the value and its rate, (k, 1) each."""
        s, left = progress(t, self.left), cs.fmax(self.left, SAME_TIME)
        rest = self.value - self.last
        value = self.last + (1 - s) ** 2 * ((1 + 2 * s) * rest + s * left * self.rate)
        rate = (1 - s) * ((1 - 3 * s) * self.rate - 6 * s * rest / left)
        return value, rate


def progress(t: cs.SX, length: cs.SX) -> cs.SX:
    """Return how much of a time is over, from 0 to 1; 1 if it has no length."""
    share = cs.fmin(cs.fmax(t / cs.fmax(length, SAME_TIME), 0), 1)
    return cs.if_else(length < SAME_TIME, 1, share)


def turned(angle: cs.SX, vector: cs.SX) -> cs.SX:
    """Return a vector in the plane, (2, 1), rotated by an angle [rad]."""
    c, s = cs.cos(angle), cs.sin(angle)
    return cs.vertcat(c * vector[0] - s * vector[1], s * vector[0] + c * vector[1])


def within_half_turn(angle: cs.SX) -> cs.SX:
    """Return an angle without its full turns [rad]."""
    return cs.atan2(cs.sin(angle), cs.cos(angle))


def _sinc(x: cs.SX) -> cs.SX:
    """Return sin(x) / x."""
    is_small = cs.fabs(x) < 1e-9
    return cs.if_else(is_small, 1, cs.sin(x) / cs.if_else(is_small, 1, x))
