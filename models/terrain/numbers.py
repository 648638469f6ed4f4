"""Small functions of places that serve CasADi expressions and NumPy arrays alike, and the checks of arguments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as cs
import numpy as np

from piaffe.errors import ModelError

from ..mujoco_import import import_mujoco

FLOOR = "floor"
"""Name of the ground's geom in MuJoCo scenes."""

DEPTH = 0.3  # [m], how far boxes reach below the floor
STONE = (0.72, 0.74, 0.78, 1.0)


def dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """Return the sum of the products of two sequences."""
    return sum(x * y for x, y in zip(a, b, strict=True))


def is_symbolic(value: Any) -> bool:
    """Return whether a value is an expression."""
    return isinstance(value, cs.SX | cs.MX | cs.DM)


def maximum(a: Any, b: Any) -> Any:
    """Return the larger of two values."""
    return cs.fmax(a, b) if is_symbolic(a) or is_symbolic(b) else np.maximum(a, b)


def within(value: Any, half: float) -> Any:
    """Return 1 where a value is at most half a width from 0, else 0."""
    return (value >= -half) * (value <= half)


def add_plane(
    spec: Any, name: str, place: Sequence[float], surface: dict[str, Any], quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0)
) -> None:
    """Add an infinite plane."""
    kind = import_mujoco().mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(name=name, type=kind, pos=place, quat=quat, size=(0, 0, 0.05), **surface)


def require(terrain: str, what: str, got: Any, holds: Any, expected: str) -> None:
    """Raise ModelError unless an argument is in range."""
    if not holds:
        raise ModelError(f"terrain {terrain}: {what} is out of range - got {got!r}, expected {expected}; change it")
