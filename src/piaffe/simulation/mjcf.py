"""Any MJCF file as a plant: its joints and feet are matched with those of a robot, and its geometry is compared."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.models import Robot, import_mujoco
from piaffe.models.terrain import Flat, Terrain

from .mjcf_geometry import compare, torque_limits
from .mjcf_names import base_body, collides, find_foot, joint_ids, no_others
from .scene import Scene

Array = NDArray[np.float64]

_ALL_BITS = 2**31 - 1


def scene_of_file(
    path: str | Path,
    robot: Robot,
    *,
    joints: Mapping[str, str] | None = None,
    feet: Mapping[str, str] | None = None,
    timestep: float,
    friction: float | None = None,
    terrain: Terrain | None = None,
    tolerance: float = 0.02,
) -> tuple[Scene, Array]:
    """Return the scene of an MJCF file, and the torque limits of its joints (n,) [Nm].

    Args:
        path: the file.
        robot: the robot for which plans are made.
        joints: from the robot's joints to those of the file; joints that are left out have the same name.
        feet: from the robot's feet to geoms, sites or bodies of the file; a foot that is left out has its name or that
            of its frame.
        timestep: of the simulator [s].
        friction: sliding friction of all geoms; by default the file's.
        terrain: the ground, if the file has none; level at z = 0 by default.
        tolerance: largest distance between joints and feet of the file and those of the robot [m].

    Raises:
        ModelError: the file cannot be read, has no free joint, or its geometry is not the robot's.
        UnknownNameError: there is no such joint or foot.
    """
    where = f"plant '{path}'"
    model, ground = _compiled(Path(path), where, timestep, friction, terrain)
    ids = joint_ids(model, robot, joints or {}, where)
    base = base_body(model, robot, ids, where)
    no_others(model, robot, ids, base, where)
    found = {foot.name: find_foot(model, robot, foot.name, foot.frame, feet or {}, where) for foot in robot.feet}
    compare(model, robot, ids, base, {name: place for name, (_, place) in found.items()}, tolerance, where)
    free = int(model.body_jntadr[base])
    first_q, first_v = int(model.jnt_qposadr[free]), int(model.jnt_dofadr[free])
    geoms = [(geom, i) for i, (own, _) in enumerate(found.values()) for geom in own]
    scene = Scene(
        robot=robot,
        compiled=model,
        positions=np.concatenate([first_q + np.arange(7), model.jnt_qposadr[ids]]),
        velocities=np.concatenate([first_v + np.arange(6), model.jnt_dofadr[ids]]),
        feet=tuple(geom for geom, _ in geoms),
        owners=tuple(i for _, i in geoms),
        base=base,
        terrain=ground,
    )
    return scene, torque_limits(model, robot, ids)


# ---- the file


def _compiled(
    path: Path, where: str, timestep: float, friction: float | None, terrain: Terrain | None
) -> tuple[Any, Terrain]:
    mujoco = import_mujoco()
    if not path.is_file():
        raise ModelError(f"{where}: no such file - got '{path}', expected an MJCF file; check the path")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.option.timestep = timestep
        model = spec.compile()
        ground = _grounds(model)
        if ground and terrain is not None:
            names = ", ".join(f"'{model.geom(geom).name}'" for geom in ground)
            raise ModelError(
                f"{where}: it has a ground of its own - got terrain={terrain!r} and geoms {names}, expected one of "
                "them; leave terrain out, or remove these geoms"
            )
        if not ground:
            (terrain or Flat()).add_to(spec, contype=_ALL_BITS, conaffinity=_ALL_BITS, friction=(1.0, 0.005, 0.0001))
            model = spec.compile()
    except ValueError as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(
            f"{where}: MuJoCo cannot read it - got '{error}', expected an MJCF file that compiles; fix it"
        ) from error
    if friction is not None:
        model.geom_friction[:, 0] = friction
        model.pair_friction[:, :2] = friction
    levels = [
        g for g in ground if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE and model.geom_quat[g][0] > 1 - 1e-9
    ]
    level = float(model.geom_pos[levels[0]][2]) if levels else 0.0
    return model, terrain or Flat(level)


def _grounds(model: Any) -> list[int]:
    """Return the geoms that do not move and collide."""
    fixed = model.body_weldid[model.geom_bodyid] == 0
    return np.flatnonzero(fixed & collides(model)).tolist()
