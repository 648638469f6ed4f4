"""Robot descriptions: where a robot's URDF lies, the model of it, and the frames where its feet may be."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio

from piaffe.errors import ModelError, UnknownNameError

from ..robot import ROOT
from .known import known_robot, names

_HERE = Path(__file__).parent
_UNBOUNDED = "1e9"  # the loader takes limits above 1e6 as none


def locate(name_or_path: str | Path) -> tuple[Path, tuple[str, ...]]:
    """Return the URDF file of a robot, by name or path, and the folders of its meshes.

    Raises:
        ModelError: there is no such file, or the package that holds it is not installed.
        UnknownNameError: it is neither a known name nor a path that ends in ``.urdf``.
    """
    known = known_robot(str(name_or_path))
    if known is None:
        path = Path(name_or_path)
        if path.suffix == ".urdf":
            if not path.exists():
                raise ModelError(f"URDF '{path}': no such file - got '{path}', expected a URDF file; check the path")
            return path, tuple(str(folder) for folder in list(path.resolve().parents)[:5])
        raise UnknownNameError("models.load", "robot", str(name_or_path), [*names(), "a path that ends in .urdf"])
    if (_HERE / known.urdf).exists():
        return _HERE / known.urdf, (str(_HERE),)
    try:
        from example_robot_data.robots_loader import getModelPath
    except ImportError as error:
        raise ModelError(
            f"robot '{name_or_path}': its URDF is not installed - got no package 'example-robot-data', expected it; "
            "pip install example-robot-data-loaders"
        ) from error
    folder = Path(getModelPath(known.urdf)).resolve()
    return folder / known.urdf, (str(folder.parent.parent), str(folder))


def build_model(urdf: Path, locked: Mapping[str, float] | None = None) -> pinocchio.Model:
    """Return the model of a URDF file with a floating base; fixed joints are merged into their parents.

    A continuous joint becomes a revolute one without limits, so that its position is one angle.

    Args:
        urdf: the file.
        locked: joints that do not move, and their positions [rad] or [m].

    Raises:
        ModelError: the file cannot be read.
        UnknownNameError: there is no joint of a name in ``locked``.
    """
    try:
        model = pinocchio.buildModelFromXML(urdf_text(urdf, bounded=True), pinocchio.JointModelFreeFlyer())
    except (ValueError, RuntimeError, ElementTree.ParseError) as error:
        raise ModelError(
            f"URDF '{urdf}': cannot be read - got '{error}', expected a URDF file; see what `piaffe doctor` says of it"
        ) from error
    if not locked:
        return model
    q, fixed = pinocchio.neutral(model), []
    for name, position in locked.items():
        if name not in list(model.names)[ROOT + 1 :]:
            raise UnknownNameError(f"URDF '{urdf}', locked", "joint", name, list(model.names)[ROOT + 1 :])
        if isinstance(position, bool) or not isinstance(position, int | float | np.number) or not np.isfinite(position):
            raise ModelError(
                f"URDF '{urdf}', locked, joint '{name}': not a position - got {position!r}, expected a finite number "
                "[rad] or [m]; give one"
            )
        fixed.append(model.getJointId(name))
        at = model.joints[fixed[-1]].idx_q
        lower, upper = float(model.lowerPositionLimit[at]), float(model.upperPositionLimit[at])
        if lower < upper and not lower - 1e-9 <= position <= upper + 1e-9:
            raise ModelError(
                f"URDF '{urdf}', locked, joint '{name}': is beyond its range - got {position:g}, expected {lower:g} to "
                f"{upper:g} [rad] or [m]; give a position within it, or correct the range"
            )
        q[at] = position
    name = model.name
    model = pinocchio.buildReducedModel(model, fixed, q)
    model.name = name
    return model


def urdf_text(urdf: Path, *, bounded: bool = False) -> str:
    """Return the text of a URDF file, whatever its encoding; ``bounded`` gives continuous joints very large limits."""
    root = ElementTree.fromstring(urdf.read_bytes())
    for joint in root.findall("joint") if bounded else ():
        if joint.get("type") != "continuous":
            continue
        joint.set("type", "revolute")
        limit = joint.find("limit")
        if limit is None:
            limit = ElementTree.SubElement(joint, "limit")
        limit.set("lower", f"-{_UNBOUNDED}")
        limit.set("upper", _UNBOUNDED)
        for key in ("effort", "velocity"):
            limit.set(key, limit.get(key, _UNBOUNDED))
    return ElementTree.tostring(root, encoding="unicode")


def leaf_frames(model: pinocchio.Model) -> list[str]:
    """Return the names of the link frames at the last joints of every leg, where feet are found."""
    parents = set(model.parents)
    return [
        frame.name
        for frame in model.frames
        if frame.type == pinocchio.FrameType.BODY and frame.parentJoint not in parents and frame.parentJoint > ROOT
    ]
