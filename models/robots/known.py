"""Known robots: what their URDFs do not say, one module a robot; this module finds them."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
import pinocchio
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEGS = (("front", "left"), ("front", "right"), ("hind", "left"), ("hind", "right"))
"""Roles of the four legs, in the order in which a known robot lists its feet."""

_CONSTANT = "ROBOT"


@dataclass(frozen=True, kw_only=True)
class KnownRobot:
    """What a URDF does not say of a known robot.

    A module of this package that defines one as ``ROBOT`` makes a robot known under the module's name.

    Args:
        urdf: its file; relative to this folder, or to those of the package example-robot-data.
        legs: names of the feet, in the order of ``LEGS``; the joints of a leg begin with its foot's name.
        foot_frame: from the foot's name to its frame, as ``"{}_FOOT"``.
        foot_radius: radius of the foot's ball [m].
        poses: joint angles per leg [rad], in the order of ``LEGS``; one row is for all legs. ``"stand"`` and
            ``"crouch"`` must be among them.
        limits: ``"torque"`` [Nm], largest ``"angle"`` [rad] and ``"speed"`` [rad/s] per joint of a leg, where the URDF
            has none or placeholders.
        add_rotors: puts the rotors' masses into the model and returns their reflected inertias, (n,) [kg m²].
    """

    urdf: str
    legs: tuple[str, str, str, str]
    foot_frame: str
    foot_radius: float
    poses: Mapping[str, tuple[tuple[float, ...], ...]]
    limits: Mapping[str, tuple[float, ...]] | None = None
    add_rotors: Callable[[pinocchio.Model], Array] | None = None


def names() -> tuple[str, ...]:
    """Return the names of the robots that are known without a file, in alphabetical order."""
    return tuple(_robots())


def known_robot(name: str) -> KnownRobot | None:
    """Return what is known of a robot, None if no module of this package has its name."""
    return _robots().get(name)


@cache
def _robots() -> Mapping[str, KnownRobot]:
    """Return all robots by name. The modules are imported at the first call, not when this package is."""
    package = importlib.import_module(__package__)
    found = {}
    for module in sorted(pkgutil.iter_modules(package.__path__), key=lambda module: module.name):
        robot = getattr(importlib.import_module(f"{__package__}.{module.name}"), _CONSTANT, None)
        if isinstance(robot, KnownRobot):
            found[module.name] = robot
    return found
