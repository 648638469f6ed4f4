"""Robot descriptions: where a robot's URDF lies, the model of it, and the frames where its feet may be."""

from __future__ import annotations

from pathlib import Path

import pinocchio

from piaffe.errors import ModelError, UnknownNameError

from ..robot import ROOT
from .known import known_robot, names

_HERE = Path(__file__).parent


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
            return path, (str(path.parent), str(path.parent.parent), str(path.parent.parent.parent))
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


def build_model(urdf: Path) -> pinocchio.Model:
    """Return the model of a URDF file with a floating base; fixed joints are merged into their parents."""
    try:
        return pinocchio.buildModelFromUrdf(str(urdf), pinocchio.JointModelFreeFlyer())
    except (ValueError, RuntimeError) as error:
        raise ModelError(
            f"URDF '{urdf}': cannot be read - got '{error}', expected a URDF file; see what `piaffe doctor` says of it"
        ) from error


def leaf_frames(model: pinocchio.Model) -> list[str]:
    """Return the names of the link frames at the last joints of every leg, where feet are found."""
    parents = set(model.parents)
    return [
        frame.name
        for frame in model.frames
        if frame.type == pinocchio.FrameType.BODY and frame.parentJoint not in parents and frame.parentJoint > ROOT
    ]
