"""The posture of the base over a terrain: height, roll and pitch of the plane that fits the ground below the feet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .base_path import turn_by
from .terrain_footsteps import TerrainFootsteps

Array = NDArray[np.float64]

TINY = 1e-6
"""Added to the second moments of the feet's places to keep them regular [m²]."""


class PlanarMotion(NamedTuple):
    """The base in the plane at times: position, velocity (S, 2) [m, m/s], yaw and its rate (S,) [rad, rad/s]."""

    position: Array
    velocity: Array
    yaw: Array
    yaw_rate: Array


class _Fit(NamedTuple):
    """The plane z = mean + slope · (p − centre) at times, and its rate: (S,), (S, 2) and (S, 2) each."""

    mean: Array
    slope: Array
    centre: Array
    mean_rate: Array
    slope_rate: Array
    centre_rate: Array


class SlopeReference:
    """Height, roll and pitch of the ground along a gait, from its footsteps.

    Args:
        footsteps: the footsteps.
    """

    def __init__(self, footsteps: TerrainFootsteps) -> None:
        self._footsteps = footsteps

    def posture(self, t: Array, base: PlanarMotion) -> tuple[Array, Array]:
        """Return the plane's height below the base [m], roll and pitch of a base parallel to it [rad], and their rates.

        Args:
            t: times, (S,) [s].
            base: the base at these times.

        Returns:
            (S, 3) each.
        """
        fit = self._fit(t)
        offset, moving = base.position - fit.centre, base.velocity - fit.centre_rate
        height = fit.mean + np.sum(fit.slope * offset, axis=-1)
        climb = fit.mean_rate + np.sum(fit.slope_rate * offset + fit.slope * moving, axis=-1)
        own = turn_by(-base.yaw, fit.slope)  # slopes ahead and to the left
        side = np.stack([own[:, 1], -own[:, 0]], axis=-1)
        own_rate = turn_by(-base.yaw, fit.slope_rate) + base.yaw_rate[:, None] * side
        ahead, left, ahead_rate, left_rate = *own.T, *own_rate.T
        steep = np.sqrt(1 + ahead**2 + left**2)
        pitch, roll = -np.arctan(ahead), np.arcsin(left / steep)
        pitch_rate = -ahead_rate / (1 + ahead**2)
        roll_rate = ((1 + ahead**2) * left_rate - left * ahead * ahead_rate) / (np.sqrt(1 + ahead**2) * steep**2)
        return np.stack([height, roll, pitch], axis=-1), np.stack([climb, roll_rate, pitch_rate], axis=-1)

    def mean_height(self, t: Array) -> Array:
        """Return the mean height of the ground of the feet, (S,) [m]."""
        return self._fit(t).mean

    def normal(self, t: Array) -> Array:
        """Return the upward normal of the plane, (S, 3)."""
        slope = self._fit(t).slope
        upward = np.column_stack([-slope, np.ones(len(slope))])
        return np.asarray(upward / np.linalg.norm(upward, axis=-1, keepdims=True))

    def _fit(self, t: Array) -> _Fit:
        """Return the plane that fits the ground of the feet best."""
        (places, moving), (heights, climbing) = self._footsteps.at(t), self._footsteps.ground(t)
        points, rates = places[..., :2], moving[..., :2]
        centre, mean, centre_rate, mean_rate = (np.mean(each, axis=1) for each in (points, heights, rates, climbing))
        d, dz = points - centre[:, None], heights - mean[:, None]
        d_rate, dz_rate = rates - centre_rate[:, None], climbing - mean_rate[:, None]
        moments = np.swapaxes(d, 1, 2) @ d + TINY * np.eye(2)
        half = np.swapaxes(d, 1, 2) @ d_rate
        moments_rate = half + np.swapaxes(half, 1, 2)
        right = np.sum(d * dz[..., None], axis=1)
        right_rate = np.sum(d_rate * dz[..., None] + d * dz_rate[..., None], axis=1)
        slope = np.linalg.solve(moments, right[..., None])[..., 0]
        bent = right_rate - (moments_rate @ slope[..., None])[..., 0]
        return _Fit(mean, slope, centre, mean_rate, np.linalg.solve(moments, bent[..., None])[..., 0], centre_rate)
