"""Unit quaternions (w, x, y, z) in CasADi and NumPy: product, Exp, Log, and their series near zero.

The CasADi functions come first, then the same functions in NumPy, over any leading axes.
Convention: body-to-world; increments are body-axis rotation vectors multiplied on the right, as MuJoCo's
``mj_integratePos`` does.
"""

from __future__ import annotations

import casadi as cs
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Below this squared angle the series is exact to rounding: the first term left out is of order angle^6.
_SMALL = 1e-5


def multiply(a: cs.SX, b: cs.SX) -> cs.SX:
    """Return the product a ⊗ b, (4, 1)."""
    w, v = a[0] * b[0] - cs.dot(a[1:], b[1:]), a[0] * b[1:] + b[0] * a[1:] + cs.cross(a[1:], b[1:])
    return cs.vertcat(w, v)


def conjugate(q: cs.SX) -> cs.SX:
    """Return the inverse of a unit quaternion, (4, 1)."""
    return cs.vertcat(q[0], -q[1:])


def exp(phi: cs.SX) -> cs.SX:
    """Return Exp of a rotation vector, (3, 1) [rad] → (4, 1)."""
    squared = cs.dot(phi, phi)
    small = squared < _SMALL
    angle = cs.sqrt(cs.if_else(small, 1.0, squared))  # CasADi evaluates both branches: the root must not be zero
    cosine = cs.if_else(small, 1 - squared / 8 + squared**2 / 384, cs.cos(angle / 2))
    sinc = cs.if_else(small, 0.5 - squared / 48 + squared**2 / 3840, cs.sin(angle / 2) / angle)
    return cs.vertcat(cosine, sinc * phi)


def log(q: cs.SX) -> cs.SX:
    """Return Log of a unit quaternion as a rotation vector of length ≤ π, (4, 1) → (3, 1) [rad]."""
    q = q * cs.if_else(q[0] < 0, -1.0, 1.0)
    squared = cs.dot(q[1:], q[1:])
    small = squared < _SMALL
    sine = cs.sqrt(cs.if_else(small, 1.0, squared))
    w = cs.if_else(small, q[0], 1.0)  # the series divides by w; where the series is used, w is near one
    series = (2 / w) * (1 - squared / (3 * w**2) + squared**2 / (5 * w**4))
    return cs.if_else(small, series, 2 * cs.atan2(sine, q[0]) / sine) * q[1:]


def matrix(q: cs.SX) -> cs.SX:
    """Return the rotation matrix body → world, (3, 3)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return cs.vertcat(
        cs.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        cs.horzcat(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        cs.horzcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def from_rpy(rpy: cs.SX) -> cs.SX:
    """Return the quaternion of R = Rz(yaw) Ry(pitch) Rx(roll), (3, 1) as roll, pitch, yaw [rad] → (4, 1)."""
    (cr, cp, cy), (sr, sp, sy) = cs.vertsplit(cs.cos(rpy / 2)), cs.vertsplit(cs.sin(rpy / 2))
    return cs.vertcat(
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def to_rpy(q: cs.SX) -> cs.SX:
    """Return roll, pitch, yaw in [−π, π], pitch in [−π/2, π/2], (4, 1) → (3, 1) [rad]."""
    R = matrix(q)
    pitch = cs.asin(cs.fmin(cs.fmax(-R[2, 0], -1.0), 1.0))
    return cs.vertcat(cs.atan2(R[2, 1], R[2, 2]), pitch, cs.atan2(R[1, 0], R[0, 0]))


def body_rate(rpy: cs.SX, rpy_rate: cs.SX) -> cs.SX:
    """Return the body angular velocity of roll-pitch-yaw angles and their rates, (3, 1) [rad/s]."""
    (dr, dp, dy), cr, sr, cp, sp = cs.vertsplit(rpy_rate), *(f(a) for a in (rpy[0], rpy[1]) for f in (cs.cos, cs.sin))
    return cs.vertcat(dr - sp * dy, cr * dp + cp * sr * dy, -sr * dp + cp * cr * dy)


# ---- the same in NumPy, over any leading axes -----------------------------------------------------------------------


def np_multiply(a: Array, b: Array) -> Array:
    """Return a ⊗ b, (..., 4)."""
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + bw * ax + ay * bz - az * by,
            aw * by + bw * ay + az * bx - ax * bz,
            aw * bz + bw * az + ax * by - ay * bx,
        ],
        axis=-1,
    )


def np_conjugate(q: Array) -> Array:
    """Return the inverse of unit quaternions, (..., 4)."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def np_exp(phi: Array) -> Array:
    """Return Exp of rotation vectors, (..., 3) [rad] → (..., 4)."""
    angle = np.linalg.norm(phi, axis=-1, keepdims=True)
    # np.sinc(x) is sin(pi x)/(pi x), exact at zero
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * phi], axis=-1)


def np_log(q: Array) -> Array:
    """Return Log of unit quaternions, length ≤ π, (..., 4) → (..., 3) [rad]."""
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    safe = np.where(sine > 1e-12, sine, 1.0)
    return np.asarray(np.where(sine > 1e-12, 2 * np.arctan2(sine, q[..., :1]) / safe, 2.0) * q[..., 1:])


def np_matrix(q: Array) -> Array:
    """Return rotation matrices body → world, (..., 4) → (..., 3, 3)."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def np_from_rpy(rpy: Array) -> Array:
    """Return quaternions of R = Rz(yaw) Ry(pitch) Rx(roll), (..., 3) as roll, pitch, yaw [rad] → (..., 4)."""
    half = np.asarray(rpy, dtype=float) / 2
    zero = np.zeros_like(half[..., 0])
    c, s = np.cos(half), np.sin(half)
    qx = np.stack([c[..., 0], s[..., 0], zero, zero], axis=-1)
    qy = np.stack([c[..., 1], zero, s[..., 1], zero], axis=-1)
    qz = np.stack([c[..., 2], zero, zero, s[..., 2]], axis=-1)
    return np_multiply(np_multiply(qz, qy), qx)


def np_to_rpy(q: Array) -> Array:
    """Return roll, pitch, yaw in (−π, π], pitch in [−π/2, π/2], (..., 4) → (..., 3) [rad]."""
    R = np_matrix(q)
    roll = np.arctan2(R[..., 2, 1], R[..., 2, 2])
    pitch = np.arcsin(np.clip(-R[..., 2, 0], -1.0, 1.0))
    yaw = np.arctan2(R[..., 1, 0], R[..., 0, 0])
    return np.stack([roll, pitch, yaw], axis=-1)


def np_body_rate(rpy: Array, rpy_rate: Array) -> Array:
    """Return the body angular velocity of roll-pitch-yaw angles and their rates, (..., 3) [rad/s]."""
    roll, pitch = rpy[..., 0], rpy[..., 1]
    dr, dp, dy = np.moveaxis(np.asarray(rpy_rate, dtype=float), -1, 0)
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    return np.stack([dr - sp * dy, cr * dp + cp * sr * dy, -sr * dp + cp * cr * dy], axis=-1)
