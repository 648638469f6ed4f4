"""Films of episodes of a receding horizon: the plant's states, with the contact forces of the simulator."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from piaffe.models import Robot, import_mujoco, mujoco_spec
from piaffe.models.terrain import Flat
from piaffe.simulation import OnlineEpisode, Plant

from .cuts import nearest
from .films import Cut, sheet, write
from .playback import Snapshot
from .studio import Studio

_FPS = 50


def film_online(
    path: Path, episode: OnlineEpisode, plant: Plant | None = None, *, size: tuple[int, int], note: str = ""
) -> Path:
    """Write a film of an episode, or, for the suffix of a picture, six moments of it; return its path.

    Args:
        path: the file, ``.mp4`` or ``.png``.
        episode: the episode; it has at least one tick.
        plant: the plant, whose ground is shown; without it, the ground is level at z = 0. Of what stands on the ground
            in a plant's file, boxes, balls, capsules, ellipsoids, cylinders and planes are shown.
        size: width and height [pixels].
        note: text beside the speed.
    """
    robot, nq = episode.robot, 7 + episode.robot.num_joints
    shown = [
        Snapshot(float(time), state[:nq], force, robot.name, tuple(bool(each) for each in touch))
        for time, state, force, touch in zip(
            episode.times, episode.states, episode.forces, episode.touching, strict=True
        )
    ]
    cut = Cut(nearest(shown), shown[0].time, shown[-1].time, 1.0, note)
    columns, rows = (1, 1) if path.suffix == ".mp4" else (3, 2)
    studio = Studio(robot, (size[0] // columns, size[1] // rows), spec=_spec(robot, plant))
    if path.suffix == ".mp4":
        return write(path, studio, [cut], robot.foot_names, fps=_FPS)
    return sheet(path, studio, cut, robot.foot_names, columns=columns, rows=rows)


def _spec(robot: Robot, plant: Plant | None) -> Any:
    """Return the ``mujoco.MjSpec`` of the robot on the plant's ground."""
    if plant is None:
        return mujoco_spec(robot, contacts="none")
    spec = mujoco_spec(robot, contacts="none", terrain=plant.scene.terrain)
    if isinstance(plant.scene.terrain, Flat):
        _add_obstacles(spec, plant.scene.compiled)
    return spec


def _add_obstacles(spec: Any, model: Any) -> None:
    """Add what does not move in a plant's file, but for level planes, as geoms without contacts."""
    kinds = import_mujoco().mjtGeom
    simple = {
        int(kind)
        for kind in (
            kinds.mjGEOM_PLANE, kinds.mjGEOM_BOX, kinds.mjGEOM_SPHERE, kinds.mjGEOM_CAPSULE, kinds.mjGEOM_ELLIPSOID,
            kinds.mjGEOM_CYLINDER,
        )
    }  # fmt: skip
    data = import_mujoco().MjData(model)
    import_mujoco().mj_kinematics(model, data)
    for geom in range(model.ngeom):
        kind, turn = int(model.geom_type[geom]), data.geom_xmat[geom].reshape(3, 3)
        level = kind == int(kinds.mjGEOM_PLANE) and turn[2, 2] > 1 - 1e-9
        if model.body_weldid[model.geom_bodyid[geom]] != 0 or kind not in simple or level:
            continue
        quaternion = np.zeros(4)
        import_mujoco().mju_mat2Quat(quaternion, turn.ravel())
        spec.worldbody.add_geom(
            type=kinds(kind), size=model.geom_size[geom], pos=data.geom_xpos[geom], quat=quaternion,
            rgba=model.geom_rgba[geom], contype=0, conaffinity=0,
        )  # fmt: skip
