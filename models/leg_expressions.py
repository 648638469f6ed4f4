"""Kinematics of single legs as CasADi expressions: the numbers of :class:`~.legs.Legs`, one leg at a time."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from .kinematics import Kinematics
from .legs import DAMPING_FLOOR, RATE_DAMPING

Array = NDArray[np.float64]

_EXACT = 1e-14  # numbers this close to 0, 1 or −1 are rounding errors of the URDF; without them expressions are shorter


@dataclass(frozen=True, eq=False)
class LegExpression:
    """One leg with k joints; the numbers are as in :class:`~.legs.Legs`.

    Args:
        foot: index of its foot.
        joints: indices of its joints in the state's order.
        rotation: (k, 3, 3).
        offset: (k, 3) [m].
        axis: (k, 3).
        revolute: (k,).
        tip: (3,) [m].
        lower: smallest angles, (k,) [rad].
        upper: largest angles, (k,) [rad].
    """

    foot: int
    joints: tuple[int, ...]
    rotation: Array
    offset: Array
    axis: Array
    revolute: Array
    tip: Array
    lower: Array
    upper: Array

    def jacobian(self, angles: cs.SX) -> tuple[cs.SX, cs.SX]:
        """Return the foot in base axes, (3, 1) [m], and its derivative by the angles, (3, k), for angles (k, 1)."""
        origin, frame = cs.SX.zeros(3), cs.SX.eye(3)
        origins, axes = [], []
        for i in range(len(self.joints)):
            origin = origin + frame @ self.offset[i]
            frame = frame @ self.rotation[i]
            axes.append(frame @ self.axis[i])
            if self.revolute[i]:
                cross = np.cross(np.eye(3), self.axis[i])
                frame = frame @ (np.eye(3) + cs.sin(angles[i]) * cross + (1 - cs.cos(angles[i])) * (cross @ cross))
            else:
                origin = origin + angles[i] * axes[i]
            origins.append(origin)
        foot = origin + frame @ self.tip
        columns = [
            cs.cross(axis, foot - at) if turns else axis
            for axis, at, turns in zip(axes, origins, self.revolute, strict=True)
        ]
        return foot, cs.horzcat(*columns)

    def inverse(self, target: cs.SX, angles: cs.SX, steps: int) -> cs.SX:
        """Return angles, (k, 1) [rad], that put the foot at a position in base axes, as :meth:`~.legs.Legs.inverse`.

        Args:
            target: wanted position in base axes, (3, 1) [m].
            angles: angles of the first iteration, (k, 1) [rad].
            steps: number of iterations.
        """
        for _ in range(steps):
            foot, jacobian = self.jacobian(angles)
            error = target - foot
            angles = angles + damped_step(jacobian, error, 0.5 * cs.sumsqr(error) + DAMPING_FLOOR)
            angles = cs.vertcat(*(self._limited(i, angles[i]) for i in range(len(self.joints))))
        return angles

    def rates(self, angles: cs.SX, velocity: cs.SX) -> cs.SX:
        """Return the rates of the angles that move the foot at a velocity in base axes, (k, 1) [rad/s]."""
        return damped_step(self.jacobian(angles)[1], velocity, cs.SX(RATE_DAMPING))

    def _limited(self, i: int, angle: cs.SX) -> cs.SX:
        if np.isfinite(self.lower[i]):
            angle = cs.fmax(angle, self.lower[i])
        return cs.fmin(angle, self.upper[i]) if np.isfinite(self.upper[i]) else angle


def leg_expressions(kinematics: Kinematics) -> tuple[LegExpression, ...]:
    """Return the legs of a robot, in the order of :attr:`Kinematics.groups`."""
    robot = kinematics.robot
    return tuple(
        LegExpression(
            foot=int(legs.feet[m]),
            joints=tuple(int(j) for j in legs.joints[m]),
            rotation=_clean(legs.rotation[m]),
            offset=_clean(legs.offset[m]),
            axis=_clean(legs.axis[m]),
            revolute=legs.revolute[m],
            tip=_clean(legs.tip[m]),
            lower=robot.joint_lower[legs.joints[m]],
            upper=robot.joint_upper[legs.joints[m]],
        )
        for legs in kinematics.groups
        for m in range(len(legs.feet))
    )


def foot_expressions(kinematics: Kinematics, joints: cs.SX) -> list[cs.SX]:
    """Return the positions of all feet in base axes, (3, 1) [m] each, for joint angles (n, 1) [rad]."""
    feet = [cs.SX(foot) for foot in kinematics.feet(kinematics.robot.pose("stand"))]  # feet without joints stay there
    for leg in leg_expressions(kinematics):
        feet[leg.foot] = leg.jacobian(joints[list(leg.joints)])[0]
    return feet


def damped_step(jacobian: cs.SX, rate: cs.SX, damping: cs.SX) -> cs.SX:
    """Return Jᵀ (J Jᵀ + λ I)⁻¹ r, (k, 1), by cofactors; with fewer than three joints the equal (JᵀJ + λ I)⁻¹ Jᵀ r."""
    if jacobian.shape[1] < 3:
        gram = jacobian.T @ jacobian + damping * np.eye(jacobian.shape[1])
        right = jacobian.T @ rate
        if jacobian.shape[1] == 1:
            return right / gram
        a, b, c = gram[0, 0], gram[0, 1], gram[1, 1]
        return cs.vertcat(c * right[0] - b * right[1], a * right[1] - b * right[0]) / (a * c - b * b)
    x, y, z = cs.vertsplit(jacobian)
    xx, yy, zz = (cs.sumsqr(row) + damping for row in (x, y, z))
    xy, xz, yz = cs.dot(x, y), cs.dot(x, z), cs.dot(y, z)
    c_xx, c_yy, c_zz = yy * zz - yz**2, xx * zz - xz**2, xx * yy - xy**2
    c_xy, c_xz, c_yz = xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz
    cofactors = cs.vertcat(cs.horzcat(c_xx, c_xy, c_xz), cs.horzcat(c_xy, c_yy, c_yz), cs.horzcat(c_xz, c_yz, c_zz))
    inverse = 1 / (xx * c_xx + xy * c_xy + xz * c_xz)  # one division: they are slow
    return jacobian.T @ (cofactors @ (inverse * rate))


def _clean(numbers: Array) -> Array:
    numbers = np.array(numbers, dtype=float)
    for exact in (0.0, 1.0, -1.0):
        numbers[np.abs(numbers - exact) < _EXACT] = exact
    return numbers
