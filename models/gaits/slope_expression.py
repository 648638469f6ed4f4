"""The posture of the base over a terrain as CasADi expressions; see :mod:`.base_slope` for the same in NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as cs

from .base_slope import TINY
from .path_expression import PathExpression, turned


class GroundPoint(NamedTuple):
    """The ground of a foot: its place in the plane (2, 1) [m] and its height [m], and the rates of both."""

    place: cs.SX
    height: cs.SX
    moving: cs.SX
    climbing: cs.SX


class SlopeExpression(NamedTuple):
    """The plane that fits the ground of the feet best.

    Args:
        posture: its height below the base [m], roll and pitch of a base parallel to it [rad], (3, 1).
        rates: the rates of these, (3, 1).
        mean: mean height of the ground of the feet [m].
        normal: upward normal, (3, 1).
    """

    posture: cs.SX
    rates: cs.SX
    mean: cs.SX
    normal: cs.SX


def slope_expression(points: Sequence[GroundPoint], path: PathExpression, tau: cs.SX) -> SlopeExpression:
    """Return the plane below the feet, as :class:`.SlopeReference`.

    Args:
        points: the ground of each foot at a time after now.
        path: the path of the base from now on.
        tau: the time after now [s].
    """
    centre, mean, centre_rate, mean_rate = (sum(each) / len(points) for each in zip(*points, strict=True))
    d, dz = [each.place - centre for each in points], [each.height - mean for each in points]
    d_rate, dz_rate = [each.moving - centre_rate for each in points], [each.climbing - mean_rate for each in points]
    moments = sum(a @ a.T for a in d) + TINY * cs.SX.eye(2)
    half = sum(a @ b.T for a, b in zip(d, d_rate, strict=True))
    right = sum(a * z for a, z in zip(d, dz, strict=True))
    right_rate = sum(b * z + a * w for a, b, z, w in zip(d, d_rate, dz, dz_rate, strict=True))
    slope = _solved(moments, right)
    slope_rate = _solved(moments, right_rate - (half + half.T) @ slope)
    offset, moving = path.position(tau) - centre, path.velocity(tau) - centre_rate
    height = mean + cs.dot(slope, offset)
    climb = mean_rate + cs.dot(slope_rate, offset) + cs.dot(slope, moving)
    yaw, yaw_rate = path.yaw(tau), path.command(tau)[2]
    own = turned(-yaw, slope)  # slopes ahead and to the left
    own_rate = turned(-yaw, slope_rate) + yaw_rate * cs.vertcat(own[1], -own[0])
    ahead, left = cs.vertsplit(own)
    ahead_rate, left_rate = cs.vertsplit(own_rate)
    steep, rise = cs.sqrt(1 + ahead**2 + left**2), 1 + ahead**2
    posture = cs.vertcat(height, cs.asin(left / steep), -cs.atan(ahead))
    roll_rate = (rise * left_rate - left * ahead * ahead_rate) / (cs.sqrt(rise) * steep**2)
    upward = cs.vertcat(-slope, 1)
    return SlopeExpression(posture, cs.vertcat(climb, roll_rate, -ahead_rate / rise), mean, upward / cs.norm_2(upward))


def _solved(matrix: cs.SX, right: cs.SX) -> cs.SX:
    """Return the solution of a symmetric system, (2, 1)."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[1, 1]
    return cs.vertcat(c * right[0] - b * right[1], a * right[1] - b * right[0]) / (a * c - b * b)
