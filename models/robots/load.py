"""Robots by name or by URDF file: ``load("mini_cheetah")``, ``load("my_robot.urdf", feet=("FL_FOOT", ...))``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
from numpy.typing import NDArray

from piaffe.errors import ModelError

from ..doctor_bodies import examine_bodies
from ..doctor_feet import examine_feet
from ..doctor_text import Finding, finding
from ..doctor_urdf import examine_text, merge_findings, root_link
from ..kinematics import Kinematics
from ..per_joint import per_joint
from ..robot import ROOT, Foot, Robot
from .description import build_model, leaf_frames, locate, urdf_text
from .feet import crossed_feet, feet_of_known, feet_with_roles
from .known import KnownRobot, known_robot, names

Array = NDArray[np.float64]

_HUGE = 1e6  # what files write for "no limit" is larger


def load(
    name_or_urdf_path: str | Path,
    *,
    feet: str | Sequence[str] | Sequence[Foot] | Mapping[str, str] | None = None,
    foot_radius: float | None = None,
    rotors: bool = False,
    joint_damping: Any = 0.0,
    joint_friction: Any = 0.0,
    poses: Mapping[str, object] | None = None,
    name: str | None = None,
    base: str | None = None,
    locked: Mapping[str, float] | None = None,
    checked: bool = True,
) -> Robot:
    """Return a robot.

    Args:
        name_or_urdf_path: one of ``names()`` or a URDF file.
        feet: frames of the feet (``"FL_FOOT FR_FOOT"`` or a list), a mapping from the feet's names to frames, or feet;
            needed for a URDF file. The order is that of every stacked foot quantity. Roles that are not given follow
            from where the feet are.
        foot_radius: radius of the foot's ball [m]; a known robot has its own, others 0.
        rotors: add the masses of the rotors where the links lack them, and their reflected inertia.
        joint_damping: viscous damping of the joints [Nm s/rad]: one number, n numbers or a mapping from labels that
            names every joint, ``{"HAA": 0.1, "HFE": 0.1, "KFE": 0.2}``. The URDF's ``<dynamics>`` is not used, because
            it often holds placeholders.
        joint_friction: dry friction of the joints [Nm], as ``joint_damping``.
        poses: named joint angles [rad], added to those that are known. Without ``"stand"`` and ``"crouch"`` a URDF file
            gets poses with the feet below their places at zero angles, legs at 3/4 and 1/2 of their reach.
        name: the robot's name; by default the known name or that in the file.
        base: ``"free"`` for a base that floats, ``"fixed"`` for one that stands still in the world, at the origin. By
            default it is free; a file must say which if its root link is called ``world`` or has no mass.
        locked: joints that do not move, and their positions, ``{"panda_finger_joint1": 0.02}`` [rad] or [m]. A joint
            that mimics another one must be among them.
        checked: whether errors of the file raise; ``piaffe doctor`` lists them instead.

    Raises:
        ModelError: the URDF cannot be read, or has what ``piaffe doctor`` calls an error, no feet are given for it, its
            base is not clear, or rotors are asked for that are not known, or a number of damping or friction is missing
            or negative.
        UnknownNameError: there is no such robot, or no such frame of a foot.
    """
    if isinstance(feet, str):
        feet = feet.split()
    known = known_robot(str(name_or_urdf_path))
    urdf, package_dirs = locate(name_or_urdf_path)
    locked = dict(locked or {})
    warnings = _refuse_errors(urdf, examine_text(urdf, locked)[0]) if checked else []
    model = build_model(urdf, locked)
    if known is None and base is None:
        _refuse_errors(urdf, list(unclear_base(urdf, model)))
    if base not in (None, "free", "fixed"):
        raise ModelError(f"models.load: unknown base - got {base!r}, expected 'free' or 'fixed'; choose one")
    model.name = name or (str(name_or_urdf_path) if known else model.name)
    joint_names = tuple(model.names[ROOT + 1 :])
    if not joint_names:
        raise ModelError(
            f"robot '{model.name}': has no joints - got none that moves, expected at least one; check the types of the "
            "joints and locked"
        )
    if feet is None and base == "fixed":
        feet = ()
    if feet is None and known is None:
        raise ModelError(
            f"robot '{model.name}': no feet - got feet=None, expected the frames of the feet of '{urdf}'; give "
            f"feet=(...) out of {leaf_frames(model)}"
        )
    if feet is None and known is not None:
        feet = feet_of_known(known)
    armature = np.zeros(len(joint_names))
    if rotors:
        armature = _rotors(model, known)
    limits: dict[str, Any] = _limits(model, known)
    robot = Robot(
        name=model.name,
        model=model,
        feet=feet_with_roles(model, feet or ()),
        foot_radius=foot_radius if foot_radius is not None else (known.foot_radius if known else 0.0),
        joint_names=joint_names,
        armature=armature,
        poses=_known_poses(joint_names, known, limits),
        urdf=urdf,
        package_dirs=package_dirs,
        recipe={
            "rotors": rotors,
            "base": base or "free",
            "locked": {key: float(value) for key, value in locked.items()},
            **({"load": str(name_or_urdf_path)} if known else {"urdf": urdf_text(urdf)}),
        },
        base="fixed" if base == "fixed" else "free",
        **limits,
    )
    losses = {"joint_damping": joint_damping, "joint_friction": joint_friction}
    losses = {key: per_joint(robot, f"models.load, {key}", value) for key, value in losses.items()}
    robot = with_poses(replace(robot, **losses), poses or {})
    if known is None and checked:
        warnings += _refuse_errors(urdf, examine_bodies(robot))
        if robot.base == "free":
            warnings += _refuse_errors(urdf, list(examine_feet(robot)))
    if checked:
        warnings = (warnings if known is None else []) + list(crossed_feet(robot.feet))
        kept = tuple(one for one in merge_findings(warnings) if one.severity == "warning")
        robot = replace(robot, warnings=kept)
    if known is None and robot.feet and robot.base == "free":
        legs = Kinematics(robot)
        drawn = {"stand": 0.75, "crouch": 0.5}
        robot = with_poses(robot, {key: legs.standing_pose(x) for key, x in drawn.items() if key not in (poses or {})})
    return robot


def unclear_base(urdf: Path, model: pinocchio.Model) -> Iterator[Finding]:
    """Yield that a file does not say whether its base floats: its root is called ``world``, or has no mass."""
    root, massless = root_link(urdf), model.inertias[ROOT].mass <= 0
    if massless or root == "world":
        got = f"a root link '{root}'" + (" without mass" if massless else "")
        advice = "models.load(..., base='fixed') for an arm on the world, base='free' for a robot that moves"
        yield finding("error", "base", "is not clear", got, "base='free' or 'fixed'", advice)


def _refuse_errors(urdf: Path, found: list[Finding]) -> list[Finding]:
    """Return the findings; raise ModelError with all that are errors."""
    errors = [one for one in found if one.severity == "error"]
    if errors:
        raise ModelError(f"URDF '{urdf}': " + "\n  ".join(f"{one.where}: {one.text}" for one in errors))
    return found


def with_poses(robot: Robot, poses: Mapping[str, object]) -> Robot:
    """Return the robot with more named poses."""
    added = {key: robot.pose(angles) for key, angles in poses.items()}
    return replace(robot, poses={**robot.poses, **added})


# ---- the parts of load


def _limits(model: pinocchio.Model, known: KnownRobot | None) -> dict[str, Array]:
    """Return the limits of the file, or those that are known better; those that are absent are infinite.

    A torque limit of zero stays: the joint is passive.
    """
    lower, upper = model.lowerPositionLimit[7:].copy(), model.upperPositionLimit[7:].copy()
    torque, speed = model.upperEffortLimit[6:].copy(), model.upperVelocityLimit[6:].copy()
    if known is not None and known.limits is not None:
        legs = len(torque) // 3
        torque, upper, speed = (np.tile(known.limits[key], legs) for key in ("torque", "angle", "speed"))
        lower = -upper
    speed[speed <= 0] = np.inf
    if known is not None:  # in their files 0 is a limit that is absent; in others the joint is passive
        torque[torque <= 0] = np.inf
    free = lower >= upper
    lower[free], upper[free] = -np.inf, np.inf
    torque[torque > _HUGE], speed[speed > _HUGE] = np.inf, np.inf
    upper[upper > _HUGE], lower[lower < -_HUGE] = np.inf, -np.inf
    return {"torque_limit": torque, "joint_lower": lower, "joint_upper": upper, "joint_speed_limit": speed}


def _known_poses(
    joint_names: tuple[str, ...], known: KnownRobot | None, limits: Mapping[str, Array]
) -> dict[str, Array]:
    """Return the poses of a known robot in state order; of another, zero or the nearest limit, as both poses."""
    if known is None:
        nearest: Array = np.clip(np.zeros(len(joint_names)), limits["joint_lower"], limits["joint_upper"])
        return {"stand": nearest, "crouch": nearest}
    poses = {}
    for key, rows in known.poses.items():
        angles = np.zeros(len(joint_names))
        for leg, row in zip(known.legs, rows * (4 // len(rows)), strict=True):
            angles[[i for i, joint in enumerate(joint_names) if joint.startswith(leg + "_")]] = row
        poses[key] = angles
    return poses


def _rotors(model: pinocchio.Model, known: KnownRobot | None) -> Array:
    """Add the rotors of a known robot to the model and return their reflected inertia, (n,)."""
    if known is None or known.add_rotors is None:
        having = [key for key in names() if getattr(known_robot(key), "add_rotors", None) is not None]
        raise ModelError(
            f"robot '{model.name}': its rotors are not known - got rotors=True, expected one of {having}; leave rotors "
            "out and give Robot(armature=...), e.g. with dataclasses.replace"
        )
    armature = known.add_rotors(model)
    model.armature[6:] = armature
    return armature
