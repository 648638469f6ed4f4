"""Films of episodes: the plant on its terrain, with the contact forces of the simulator."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from piaffe.simulation import Episode, foot_forces

from .cuts import nearest
from .films import Cut, sheet, write
from .playback import Snapshot
from .studio import Studio

_TOUCHES_N = 1e-3


def film_episode(path: Path, plant: Any, episode: Episode, *, size: tuple[int, int], note: str = "") -> Path:
    """Write a film of an episode, or, for the suffix of a picture, six moments of it; return its path.

    Args:
        path: the file, ``.mp4`` or ``.png``.
        plant: the simulated ``models.Mujoco``.
        episode: the episode.
        size: width and height [pixels].
        note: text beside the speed.
    """
    shown = snapshots(plant, episode)
    cut = Cut(nearest(shown), shown[0].time, shown[-1].time, 1.0, note)
    feet = [foot.name for foot in plant.robot.feet]
    columns, rows = (1, 1) if path.suffix == ".mp4" else (3, 2)
    studio = Studio(plant.robot, (size[0] // columns, size[1] // rows), spec=plant.spec(visuals=True))
    if path.suffix == ".mp4":
        return write(path, studio, [cut], feet, fps=round(1 / plant.dt))
    return sheet(path, studio, cut, feet, columns=columns, rows=rows)


def snapshots(plant: Any, episode: Episode) -> list[Snapshot]:
    """Return a snapshot per state; forces are those of the state and the control applied to it."""
    import mujoco

    model = plant.compiled()
    data = mujoco.MjData(model)
    feet = [model.geom(foot.name).id for foot in plant.robot.feet]
    found = []
    actions = np.concatenate([episode.actions, episode.actions[-1:]])
    for time, state, action in zip(episode.times, episode.states, actions, strict=True):
        data.qpos[:], data.qvel[:] = state[: model.nq], state[model.nq :]
        data.ctrl[:] = plant.control_to_ctrl(action)
        mujoco.mj_forward(model, data)
        forces = foot_forces(model, data, feet)
        touches = tuple(bool(np.linalg.norm(force) > _TOUCHES_N) for force in forces)
        found.append(Snapshot(float(time), np.array(data.qpos), forces, plant.name, touches))
    return found
