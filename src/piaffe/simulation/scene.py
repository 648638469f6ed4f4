"""A compiled MuJoCo model, and where the state of a robot lies in it."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.models import Mujoco, Robot, import_mujoco
from piaffe.models.terrain import Terrain

Array = NDArray[np.float64]
Indices = NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class Scene:
    """A MuJoCo model with a robot in it.

    The state is x = (q, v) in the order of the robot's joints: q are the base's position and quaternion and the joint
    angles, v the base's velocities and the joint velocities.

    Args:
        robot: the robot.
        compiled: the ``mujoco.MjModel``; a scene has its own.
        positions: index in ``qpos`` of each entry of q, (nq,).
        velocities: index in ``qvel`` of each entry of v, (nv,).
        feet: ids of the geoms of the feet.
        owners: index of the foot of each of these geoms.
        base: id of the body of the base.
        terrain: height of the ground.
        direct: whether controls are torques on the joints, without MuJoCo's actuators.
    """

    robot: Robot
    compiled: Any
    positions: Indices
    velocities: Indices
    feet: tuple[int, ...]
    owners: tuple[int, ...]
    base: int
    terrain: Terrain
    direct: bool = False


def scene_of(model: Mujoco) -> Scene:
    """Return the scene of a model; its state is MuJoCo's."""
    compiled: Any = copy.copy(model.compiled())
    allow(compiled, "WARMSTART")
    return Scene(
        robot=model.robot,
        compiled=compiled,
        positions=np.arange(compiled.nq),
        velocities=np.arange(compiled.nv),
        feet=tuple(compiled.geom(foot.name).id for foot in model.robot.feet),
        owners=tuple(range(len(model.robot.feet))),
        base=1,
        terrain=model.terrain,
    )


def allow(compiled: Any, *features: str) -> None:
    """Switch features of a ``mujoco.MjModel`` on, as ``"DAMPER"``."""
    for name in features:
        compiled.opt.disableflags &= ~int(getattr(import_mujoco().mjtDisableBit, f"mjDSBL_{name}"))


def forbid(compiled: Any, *features: str) -> None:
    """Switch features of a ``mujoco.MjModel`` off."""
    for name in features:
        compiled.opt.disableflags |= int(getattr(import_mujoco().mjtDisableBit, f"mjDSBL_{name}"))
