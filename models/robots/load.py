"""Robots by name or by URDF file: ``load("mini_cheetah")``, ``load("my_robot.urdf", feet=("FL_FOOT", ...))``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path

import numpy as np
import pinocchio
from numpy.typing import NDArray

from piaffe.errors import ModelError, UnknownNameError

from ..kinematics import Kinematics
from ..robot import ROOT, Foot, Robot

Array = NDArray[np.float64]

_MODELS = Path(__file__).parent
# The four legs by role, in the order in which each robot's own names are listed below.
_LEGS = (("front", "left"), ("front", "right"), ("hind", "left"), ("hind", "right"))


@dataclass(frozen=True)
class _Known:
    """What a URDF does not say of a known robot.

    Args:
        urdf: its file; relative to this folder, or to those of the package example-robot-data.
        legs: names of the feet in the order of ``_LEGS``.
        foot_frame: from the foot's name to its frame.
        foot_radius: [m].
        poses: angles per leg, in the order of ``_LEGS``; one row is for all legs.
        limits: torque [Nm], largest angle and speed per joint of a leg where the URDF has none or placeholders.
        add_rotors: puts the rotors' masses into the model and returns their reflected inertias, (n,).
    """

    urdf: str
    legs: tuple[str, str, str, str]
    foot_frame: str
    foot_radius: float
    poses: Mapping[str, tuple[tuple[float, ...], ...]]
    limits: Mapping[str, tuple[float, ...]] | None = None
    add_rotors: Callable[[pinocchio.Model], Array] | None = None


def load(
    name_or_urdf_path: str | Path,
    *,
    feet: str | Sequence[str] | Sequence[Foot] | Mapping[str, str] | None = None,
    foot_radius: float | None = None,
    rotors: bool = False,
    poses: Mapping[str, object] | None = None,
    name: str | None = None,
) -> Robot:
    """Return a robot.

    Args:
        name_or_urdf_path: one of ``names()`` or a URDF file.
        feet: frames of the feet (``"FL_FOOT FR_FOOT"`` or a list), a mapping from the feet's names to frames, or feet;
            needed for a URDF file. The order is that of every stacked foot quantity. Roles that are not given follow
            from where the feet are.
        foot_radius: radius of the foot's ball [m]; a known robot has its own, others 0.
        rotors: add the masses of the rotors where the links lack them, and their reflected inertia.
        poses: named joint angles [rad], added to those that are known. Without ``"stand"`` and ``"crouch"`` a URDF file
            gets poses with the feet below their places at zero angles, legs at 3/4 and 1/2 of their reach.
        name: the robot's name; by default the known name or that in the file.
    """
    if isinstance(feet, str):
        feet = feet.split()
    known = _KNOWN.get(str(name_or_urdf_path))
    urdf, package_dirs = locate(name_or_urdf_path)
    model = build_model(urdf)
    model.name = name or (str(name_or_urdf_path) if known else model.name)
    joint_names = tuple(model.names[ROOT + 1 :])
    if feet is None and known is None:
        raise ModelError(
            f"robot '{model.name}': no feet - got feet=None, expected the frames of the feet of '{urdf}'; give "
            f"feet=(...) out of {leaf_frames(model)}"
        )
    if feet is None and known is not None:
        feet = [
            Foot(leg, known.foot_frame.format(leg), frozenset(roles))
            for leg, roles in zip(known.legs, _LEGS, strict=True)
        ]
    armature = np.zeros(len(joint_names))
    if rotors:
        armature = _rotors(model, known)
    limits = _limits(model, known)
    robot = Robot(
        name=model.name,
        model=model,
        feet=_feet(model, feet or ()),
        foot_radius=foot_radius if foot_radius is not None else (known.foot_radius if known else 0.0),
        joint_names=joint_names,
        armature=armature,
        poses=_known_poses(joint_names, known),
        urdf=urdf,
        package_dirs=package_dirs,
        recipe={"rotors": rotors, **({"load": str(name_or_urdf_path)} if known else {"urdf": urdf.read_text()})},
        **limits,
    )
    robot = with_poses(robot, poses or {})
    if known is None:
        legs = Kinematics(robot)
        drawn = {"stand": 0.75, "crouch": 0.5}
        robot = with_poses(robot, {key: legs.standing_pose(x) for key, x in drawn.items() if key not in (poses or {})})
    return robot


def names() -> tuple[str, ...]:
    """Return the names of the robots that are known without a file."""
    return tuple(_KNOWN)


def build_model(urdf: Path) -> pinocchio.Model:
    """Return the model of a URDF file with a floating base; fixed joints are merged into their parents."""
    try:
        return pinocchio.buildModelFromUrdf(str(urdf), pinocchio.JointModelFreeFlyer())
    except (ValueError, RuntimeError) as error:
        raise ModelError(
            f"URDF '{urdf}': cannot be read - got '{error}', expected a URDF file; see what `piaffe doctor` says of it"
        ) from error


def with_poses(robot: Robot, poses: Mapping[str, object]) -> Robot:
    """Return the robot with more named poses."""
    added = {key: robot.pose(angles) for key, angles in poses.items()}
    return replace(robot, poses={**robot.poses, **added})


# ---- the parts of load


def locate(name_or_path: str | Path) -> tuple[Path, tuple[str, ...]]:
    """Return the URDF file of a robot, by name or path, and the folders of its meshes."""
    known = _KNOWN.get(str(name_or_path))
    if known is None:
        path = Path(name_or_path)
        if path.suffix == ".urdf":
            if not path.exists():
                raise ModelError(f"URDF '{path}': no such file - got '{path}', expected a URDF file; check the path")
            return path, (str(path.parent), str(path.parent.parent), str(path.parent.parent.parent))
        raise UnknownNameError("models.load", "robot", str(name_or_path), [*names(), "a path that ends in .urdf"])
    if (_MODELS / known.urdf).exists():
        return _MODELS / known.urdf, (str(_MODELS),)
    try:
        from example_robot_data.robots_loader import getModelPath
    except ImportError as error:
        raise ModelError(
            f"robot '{name_or_path}': its URDF is not installed - got no package 'example-robot-data', expected it; "
            "pip install example-robot-data-loaders"
        ) from error
    folder = Path(getModelPath(known.urdf)).resolve()
    return folder / known.urdf, (str(folder.parent.parent), str(folder))


def _feet(model: pinocchio.Model, feet: Sequence[str] | Sequence[Foot] | Mapping[str, str]) -> tuple[Foot, ...]:
    """Return feet with roles; where they are not given, by the feet's places at zero joint angles."""
    pairs = feet.items() if isinstance(feet, Mapping) else [(f, f) if isinstance(f, str) else ("", f) for f in feet]
    made = [frame if isinstance(frame, Foot) else Foot(_short(label), frame) for label, frame in pairs]
    for foot in made:
        if not model.existFrame(foot.frame):
            raise UnknownNameError(f"robot '{model.name}', foot '{foot.name}'", "frame", foot.frame, leaf_frames(model))
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, pinocchio.neutral(model))
    places = np.array([data.oMf[model.getFrameId(foot.frame)].translation[:2] for foot in made])
    centre = places.mean(axis=0)
    return tuple(
        foot if foot.roles else replace(foot, roles=_roles(xy - centre)) for foot, xy in zip(made, places, strict=True)
    )


def _roles(offset: Array) -> frozenset[str]:
    """Return the roles of a foot that lies at an offset (x forward, y left) from the middle of all feet."""
    roles = []
    if abs(offset[0]) > 1e-3:
        roles.append("front" if offset[0] > 0 else "hind")
    if abs(offset[1]) > 1e-3:
        roles.append("left" if offset[1] > 0 else "right")
    return frozenset(roles)


def _short(frame: str) -> str:
    """Return a foot's name from its frame's: ``FL_FOOT`` → ``FL``."""
    for ending in ("_foot", "_toe", "_ankle", "_contact"):
        if frame.lower().endswith(ending):
            return frame[: -len(ending)]
    return frame


def leaf_frames(model: pinocchio.Model) -> list[str]:
    """Return the names of the link frames at the last joints of every leg, where feet are found."""
    parents = set(model.parents)
    return [
        frame.name
        for frame in model.frames
        if frame.type == pinocchio.FrameType.BODY and frame.parentJoint not in parents and frame.parentJoint > ROOT
    ]


def _limits(model: pinocchio.Model, known: _Known | None) -> dict[str, Array]:
    """Return the limits of the file, or those that are known better; a limit that is absent or zero is infinite."""
    lower, upper = model.lowerPositionLimit[7:].copy(), model.upperPositionLimit[7:].copy()
    torque, speed = model.upperEffortLimit[6:].copy(), model.upperVelocityLimit[6:].copy()
    if known is not None and known.limits is not None:
        legs = len(torque) // 3
        torque, upper, speed = (np.tile(known.limits[key], legs) for key in ("torque", "angle", "speed"))
        lower = -upper
    torque[torque <= 0], speed[speed <= 0] = np.inf, np.inf
    free = lower >= upper
    lower[free], upper[free] = -np.inf, np.inf
    huge = 1e6  # what files write for "none"
    torque[torque > huge], speed[speed > huge], upper[upper > huge], lower[lower < -huge] = (
        np.inf,
        np.inf,
        np.inf,
        -np.inf,
    )
    return {"torque_limit": torque, "joint_lower": lower, "joint_upper": upper, "joint_speed_limit": speed}


def _known_poses(joint_names: tuple[str, ...], known: _Known | None) -> dict[str, Array]:
    """Return the poses of a known robot in state order; of another, zero angles under the names that must exist."""
    if known is None:
        return {"stand": np.zeros(len(joint_names)), "crouch": np.zeros(len(joint_names))}
    poses = {}
    for key, rows in known.poses.items():
        angles = np.zeros(len(joint_names))
        for leg, row in zip(known.legs, rows * (4 // len(rows)), strict=True):
            angles[[i for i, joint in enumerate(joint_names) if joint.startswith(leg + "_")]] = row
        poses[key] = angles
    return poses


def _rotors(model: pinocchio.Model, known: _Known | None) -> Array:
    """Add the rotors of a known robot to the model and return their reflected inertia, (n,)."""
    if known is None or known.add_rotors is None:
        having = [key for key, entry in _KNOWN.items() if entry.add_rotors is not None]
        raise ModelError(
            f"robot '{model.name}': its rotors are not known - got rotors=True, expected one of {having}; leave rotors "
            "out and give Robot(armature=...), e.g. with dataclasses.replace"
        )
    armature = known.add_rotors(model)
    model.armature[6:] = armature
    return armature


def _mini_cheetah_rotors(model: pinocchio.Model) -> Array:
    """Add 12 rotors of 55 g; gear ratios 6, 6, 9.33 and 63e-6 kg m^2 about the spin axis (Cheetah-Software)."""
    about_x, about_y = np.diag([63e-6, 33e-6, 33e-6]), np.diag([33e-6, 63e-6, 33e-6])
    for leg in _KNOWN["mini_cheetah"].legs:
        front, side = (1 if leg[0] == "F" else -1), (1 if leg[1] == "L" else -1)
        places = (
            (ROOT, (0.125 * front, 0.049 * side, 0.0), about_x),
            (model.getJointId(f"{leg}_HAA"), (0.0, 0.04 * side, 0.0), about_y),
            (model.getJointId(f"{leg}_HFE"), (0.0, 0.0, 0.0), about_y),
        )
        for joint, place, inertia in places:
            model.inertias[joint] += pinocchio.Inertia(0.055, np.array(place), inertia)
    return np.tile(63e-6 * np.array([6.0, 6.0, 9.33]) ** 2, 4)


def _solo12_rotors(model: pinocchio.Model) -> Array:
    """Return the reflected inertia of Solo's motors, 5.3e-6 kg m^2 behind a ratio of 9; the links hold their masses."""
    return np.full(model.nv - 6, 5.3e-6 * 9.0**2)


# Solo12's URDF holds placeholders (1000 Nm, 10 rad) for its limits. Here: its actuator's 0.225 Nm/A at 12 A, angles
# that keep the links apart, and a speed that its motors hold under load.
_KNOWN = {
    "mini_cheetah": _Known(
        urdf="urdf/mini_cheetah.urdf",
        legs=("FL", "FR", "HL", "HR"),
        foot_frame="{}_FOOT",
        foot_radius=0.0175,
        poses={
            "stand": ((0.0, -1.0, 2.0),),
            "crouch": ((0.0, -1.2, 2.4),),
            "tuck": ((0.3, -1.1, 2.2), (-0.3, -1.1, 2.2)) * 2,
            "lean": ((pi / 6, -1.0, 2.0), (-pi / 5, -0.5, 1.0)) * 2,
        },
        add_rotors=_mini_cheetah_rotors,
    ),
    "solo12": _Known(
        urdf="solo_description/robots/solo12.urdf",
        legs=("FL", "FR", "HL", "HR"),
        foot_frame="{}_FOOT",
        foot_radius=0.0165,
        poses={
            "stand": ((0.0, 0.8, -1.6), (0.0, 0.8, -1.6), (0.0, -0.8, 1.6), (0.0, -0.8, 1.6)),
            "crouch": ((0.0, 1.1, -2.2), (0.0, 1.1, -2.2), (0.0, -1.1, 2.2), (0.0, -1.1, 2.2)),
        },
        limits={"torque": (2.7, 2.7, 2.7), "angle": (1.2, 2.6, 2.9), "speed": (30.0, 30.0, 30.0)},
        add_rotors=_solo12_rotors,
    ),
    "go2": _Known(
        urdf="go2_description/urdf/go2.urdf",
        legs=("FL", "FR", "RL", "RR"),
        foot_frame="{}_foot",
        foot_radius=0.022,
        poses={"stand": ((0.0, 0.8, -1.6),), "crouch": ((0.0, 1.15, -2.3),)},
    ),
    "anymal_c": _Known(
        urdf="anymal_c_simple_description/urdf/anymal.urdf",
        legs=("LF", "RF", "LH", "RH"),
        foot_frame="{}_FOOT",
        foot_radius=0.03,
        poses={
            "stand": ((0.0, 0.7, -1.2), (0.0, 0.7, -1.2), (0.0, -0.7, 1.2), (0.0, -0.7, 1.2)),
            "crouch": ((0.0, 1.0, -1.9), (0.0, 1.0, -1.9), (0.0, -1.0, 1.9), (0.0, -1.0, 1.9)),
        },
    ),
}
