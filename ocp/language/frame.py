"""Planar frames (x, y, yaw), and samples moved from one to another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import rotation
from .manifold import Manifold
from .model import Sample
from .quantity import Quantity

Array = NDArray[np.float64]
PlanarFrame = tuple[float, float, float]

ORIGIN: PlanarFrame = (0.0, 0.0, 0.0)


def relative(to: PlanarFrame, of: PlanarFrame) -> PlanarFrame:
    """Return the planar motion that maps frame ``of`` onto frame ``to``, (x, y, yaw) [m, m, rad]."""
    yaw = to[2] - of[2]
    c, s = np.cos(yaw), np.sin(yaw)
    return (to[0] - (c * of[0] - s * of[1]), to[1] - (s * of[0] + c * of[1]), yaw)


def composed(first: PlanarFrame, second: PlanarFrame) -> PlanarFrame:
    """Return the planar motion that does ``second``, then ``first``."""
    c, s = np.cos(first[2]), np.sin(first[2])
    x, y, yaw = second
    return (first[0] + c * x - s * y, first[1] + s * x + c * y, first[2] + yaw)


def inverse(motion: PlanarFrame) -> PlanarFrame:
    """Return the planar motion that undoes another."""
    return relative(ORIGIN, motion)


def transform_value(quantity: Quantity, value: Array, frame: PlanarFrame) -> Array:
    """Return a quantity's value (..., n) transformed by a planar motion."""
    if frame == ORIGIN or quantity.kind == "vector":
        return value
    x, y, yaw = frame
    if quantity.kind == "rotation":
        turn = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
        return rotation.np_multiply(np.broadcast_to(turn, value.shape), value)
    points = value.reshape(*value.shape[:-1], -1, 3).copy()
    c, s = np.cos(yaw), np.sin(yaw)
    px, py = points[..., 0].copy(), points[..., 1].copy()
    points[..., 0], points[..., 1] = c * px - s * py, s * px + c * py
    if quantity.kind == "point":
        points[..., 0] += x
        points[..., 1] += y
    return points.reshape(value.shape)


def transform_state(space: Manifold, x: Array, frame: PlanarFrame) -> Array:
    """Return states, or controls, (..., nx) transformed by a planar motion."""
    return space.pack({q: transform_value(q, value, frame) for q, value in space.unpack(x).items()})


def transform(sample: Sample, frame: PlanarFrame) -> dict[Quantity, Array]:
    """Return a sample transformed by a planar motion."""
    return {quantity: transform_value(quantity, value, frame) for quantity, value in sample.items()}
