"""Roll, pitch and yaw along a motion: without jumps, full turns counted, and steady where the base is vertical."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import rotation

Array = NDArray[np.float64]

_NEAR_VERTICAL = np.radians(20.0)
"""Within this angle of a vertical base, the angle that is not determined there is held [rad]."""


def continuous_rpy(quaternions: Array, near: Array | None = None) -> Array:
    """Return roll, pitch, yaw of a motion, each triple near to the one before, (n, 4) → (n, 3) [rad].

    Full turns are counted, and a pitch may exceed ±π/2: a flip backwards goes from 0 to −2π while roll and yaw stay.
    With the half angles δ = (roll − yaw) / 2, σ = (roll + yaw) / 2 and η = pitch/2 + π/4, a quaternion (w, x, y, z) of
    R = Rz(yaw) Ry(pitch) Rx(roll) obeys::

        (w + y) + i (x − z) = √2 sin(η) exp(i δ)
        (w − y) + i (x + z) = √2 cos(η) exp(i σ)

    So δ is not determined where the pitch is −π/2 (mod 2π), and σ where it is π/2. Within 20° of there it is near to
    its last value outside: it differs by a share of the measured difference, which falls to zero at the vertical.
    Elsewhere, each triple is exact.

    Args:
        quaternions: orientations in order of time, (n, 4), w first. Rows of NaN stay NaN, and the angles after them
            are near to those before them.
        near: roll, pitch, yaw to which the first triple is near, (3,) [rad]; by default the triple with the smallest
            angles.
    """
    found = np.full((len(quaternions), 3), np.nan)
    known = np.flatnonzero(np.all(np.isfinite(quaternions), axis=1))
    if known.size == 0:
        return found
    roll, pitch, yaw = _smallest(quaternions[known[0]]) if near is None else near
    delta, sigma, eta = _Half((roll - yaw) / 2), _Half((roll + yaw) / 2), pitch / 2 + np.pi / 4
    for k in known:
        w, x, y, z = quaternions[k]
        sine, cosine = delta.follow(complex(w + y, x - z)), sigma.follow(complex(w - y, x + z))
        eta = _nearest(float(np.arctan2(sine, cosine)), eta)
        found[k] = delta.angle + sigma.angle, 2 * eta - np.pi / 2, sigma.angle - delta.angle
    return found


class _Half:
    """One of the half angles δ and σ along a motion: its angle, and its last value away from the vertical."""

    def __init__(self, angle: float) -> None:
        self.angle = self._held = angle

    def follow(self, value: complex) -> float:
        """Move to the angle of a complex number up to its sign; return the number's length with its sign."""
        length = abs(value)
        share = (length / (np.sqrt(2) * np.sin(_NEAR_VERTICAL / 2))) ** 4
        angle = _nearest(float(np.angle(value)), self._held if share < 1 else self.angle)
        self.angle = self._held + share * (angle - self._held) if share < 1 else angle
        if share >= 1:
            self._held = angle
        return length * float(np.sign(np.cos(np.angle(value) - angle)))


def _nearest(angle: float, to: float) -> float:
    """Return the angle that differs by a multiple of π and is nearest to another one."""
    return float(angle + np.pi * np.round((to - angle) / np.pi))


def _smallest(quaternion: Array) -> Array:
    """Return the triple with the smallest angles of an orientation, (3,)."""
    usual = rotation.np_to_rpy(quaternion)
    other = usual + np.array([np.pi, np.pi - 2 * usual[1], np.pi])
    other -= 2 * np.pi * np.round(other / (2 * np.pi))
    return np.asarray(min(usual, other, key=lambda angles: float(np.linalg.norm(angles))))
