"""Recipes: what a file holds of a robot, so that it can be drawn and simulated where the file is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError

from ..robot import Foot, Robot
from .load import load

Array = NDArray[np.float64]

_LIMITS = ("torque_limit", "joint_lower", "joint_upper", "joint_speed_limit", "armature")
_LOSSES = ("joint_damping", "joint_friction")  # recipes of earlier versions have none


def robot_recipe(robot: Robot) -> dict[str, Any]:
    """Return a robot's recipe, JSON-able: a known name or the URDF's text, feet, limits, poses; empty if there is none.

    Robots made by :func:`piaffe.models.load` have one. Their limits, poses and feet are stored as they are now.
    """
    if not robot.recipe:
        return {}
    return {
        **robot.recipe,
        "name": robot.name,
        "feet": [[foot.name, foot.frame, sorted(foot.roles)] for foot in robot.feet],
        "foot_radius": robot.foot_radius,
        "package_dirs": list(robot.package_dirs) if "urdf" in robot.recipe else [],
        "poses": {name: np.asarray(angles).tolist() for name, angles in robot.poses.items()},
        **{name: [float(v) if np.isfinite(v) else None for v in getattr(robot, name)] for name in (*_LIMITS, *_LOSSES)},
    }


def robot_from_recipe(recipe: Mapping[str, Any]) -> Robot:
    """Return the robot of a recipe.

    Args:
        recipe: made by :func:`robot_recipe`, or a model's recipe that holds one under ``"robot"``.

    Raises:
        ModelError: the recipe is empty: the robot was not made by ``models.load``, or there was none.
    """
    stored: Mapping[str, Any] = recipe.get("robot", recipe)
    if not ("load" in stored or "urdf" in stored):
        raise ModelError(
            f"recipe: there is no robot in it - got keys {sorted(stored)}, expected 'load' or 'urdf'; use a solution "
            "of a robot that was made by models.load"
        )
    feet = [Foot(name, frame, frozenset(roles)) for name, frame, roles in stored["feet"]]
    options: dict[str, Any] = {key: stored[key] for key in ("foot_radius", "poses", "name", "rotors")}
    # recipes of earlier versions have no base, and their files were not checked
    options |= {"base": stored.get("base", "free"), "locked": stored.get("locked"), "checked": "base" in stored}
    if "load" in stored:
        robot = load(stored["load"], feet=feet, **options)
        return replace(robot, **_limits(stored))
    with TemporaryDirectory() as folder:
        urdf = Path(folder) / "robot.urdf"
        urdf.write_text(stored["urdf"])
        robot = load(urdf, feet=feet, **options)
        robot = replace(robot, package_dirs=tuple(stored["package_dirs"]), **_limits(stored))
        _ = robot.visual  # read and kept now, while the file is there
    return robot


def _limits(stored: Mapping[str, Any]) -> dict[str, Any]:
    missing = dict.fromkeys(_LIMITS, np.inf) | {"joint_lower": -np.inf}
    return {
        name: np.array([missing[name] if value is None else value for value in stored[name]], dtype=float)
        for name in (*_LIMITS, *(name for name in _LOSSES if name in stored))
    }
