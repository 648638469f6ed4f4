"""Terrains: ground whose height is known everywhere, in expressions, in numbers and as MuJoCo geoms."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as cs
import numpy as np

from .mujoco_look import FLOOR, import_mujoco


class Terrain(ABC):
    """Ground without overhangs: one height for every place in the plane."""

    @abstractmethod
    def height(self, x: Any, y: Any) -> Any:
        """Return the ground's height at a place [m].

        Args:
            x: CasADi expressions or NumPy arrays of any shape [m].
            y: the same [m].
        """

    @abstractmethod
    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add the ground's geoms to the world of a ``mujoco.MjSpec``, each with the given options of a surface."""

    def mean_height(self, xs: Sequence[Any], ys: Sequence[Any]) -> Any:
        """Return the mean height of the ground at some places [m]."""
        return sum(self.height(x, y) for x, y in zip(xs, ys, strict=True)) / len(xs)


@dataclass(frozen=True)
class Flat(Terrain):
    """Level ground.

    Args:
        level: its height [m]; a number, or (within a model) an expression.
    """

    level: Any = 0.0

    def height(self, x: Any, y: Any) -> Any:
        """Return the level."""
        return self.level if _is_symbolic(x) else np.full(np.broadcast_shapes(np.shape(x), np.shape(y)), self.level)

    def mean_height(self, xs: Sequence[Any], ys: Sequence[Any]) -> Any:
        """Return the level."""
        return self.height(xs[0], ys[0])

    def add_to(self, spec: Any, **surface: Any) -> None:
        """Add a plane."""
        add_plane(spec, FLOOR, (0.0, 0.0, float(self.level)), (1.0, 0.0, 0.0, 0.0), surface)


def flat(level: float = 0.0) -> Flat:
    """Return level ground.

    Args:
        level: its height [m].
    """
    return Flat(level)


def add_plane(
    spec: Any, name: str, place: Sequence[float], quaternion: Sequence[float], surface: dict[str, Any]
) -> None:
    """Add an endless plane."""
    spec.worldbody.add_geom(
        name=name, type=import_mujoco().mjtGeom.mjGEOM_PLANE, pos=place, quat=quaternion, size=(0, 0, 0.05), **surface
    )


def _is_symbolic(value: Any) -> bool:
    return isinstance(value, cs.SX | cs.MX | cs.DM)
