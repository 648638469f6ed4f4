"""Figures of an episode with a roll: moments with the bar, height of the base over the bar, torques."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from roll_log import EVERY, Roll

from piaffe import models, simulation
from piaffe.files import whole_file
from piaffe.viz.cuts import nearest
from piaffe.viz.films import Cut, sheet
from piaffe.viz.playback import Snapshot
from piaffe.viz.studio import Studio
from piaffe.viz.style import BOUND, FAINT, LEGS, RC, SHADES

if TYPE_CHECKING:
    from rolls import Task

MOMENTS = (4, 2)  # columns and rows of pictures
LOW = 0.2  # [m], lower bars say nothing of a jump and are not drawn
KINDS = ("abduction", "hip", "knee")


def draw(folder: Path, name: str, task: Task, episode: simulation.OnlineEpisode, seed: int) -> None:
    """Draw the figures of an episode into a folder; their names begin with that of the task."""
    roll = Roll.of(task.problem(), task.number)
    over = (episode.times >= roll.begins - 0.1) & (episode.times <= roll.ends)
    along = task.turn + float(np.interp(roll.begins, episode.times, episode.yaw))
    shapes = models.mujoco_model(episode.robot, hull=True)
    bar = simulation.highest_bar(shapes, episode.states[over][::EVERY], along=along)
    _moments(folder / f"{name}_moments.png", episode, roll, bar)
    _heights(folder / f"{name}_height.png", f"{task.title}, seed {seed}", episode, roll, bar)
    _torques(folder / f"{name}_torques.png", f"{task.title}, seed {seed}", episode, roll)


def _moments(path: Path, episode: simulation.OnlineEpisode, roll: Roll, bar: simulation.Bar) -> None:
    """Draw equally spaced moments from the start of the roll to its end, with the bar in red."""
    spec: Any = models.mujoco_spec(episode.robot, contacts="none")
    if bar.height > LOW:
        import mujoco

        way, side = np.array([np.cos(bar.along), np.sin(bar.along)]), np.array([-np.sin(bar.along), np.cos(bar.along)])
        at = episode.states[int(np.searchsorted(episode.times, roll.takes_off)), :2]
        middle = side * bar.place + way * (way @ at)
        ends = [[*(middle + sign * way), bar.height - 0.008] for sign in (-1.0, 1.0)]
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=np.ravel(ends), size=(0.008, 0, 0), rgba=(0.8, 0.1, 0.1, 1),
            contype=0, conaffinity=0,
        )  # fmt: skip
    nq = 7 + episode.robot.num_joints
    shown = [
        Snapshot(float(t), x[:nq], f, episode.robot.name, tuple(bool(each) for each in on))
        for t, x, f, on in zip(episode.times, episode.states, episode.forces, episode.touching, strict=True)
        if roll.begins - 0.05 <= t <= roll.ends
    ]
    cut = Cut(nearest(shown), shown[0].time, shown[-1].time)
    columns, rows = MOMENTS
    sheet(path, Studio(episode.robot, (360, 270), spec=spec), cut, episode.robot.foot_names, columns=columns, rows=rows)


def _shaded(figure: Figure, count: int, roll: Roll) -> list[Any]:
    """Return axes above each other in which the flight of the roll is shaded."""
    axes = np.atleast_1d(figure.subplots(count, 1, sharex=True)).tolist()
    for ax in axes:
        ax.axvspan(roll.takes_off, roll.lands, color=SHADES[0])
    axes[-1].set_xlabel("time [s]")
    return axes


def _heights(path: Path, title: str, episode: simulation.OnlineEpisode, roll: Roll, bar: simulation.Bar) -> None:
    with rc_context(RC):
        figure = Figure(figsize=(6.5, 3.0), layout="constrained")
        (ax,) = _shaded(figure, 1, roll)
        near = (episode.times >= roll.begins - 0.6) & (episode.times <= roll.ends + 0.6)
        ax.plot(episode.times[near], episode.states[near, 2], color=LEGS[0], label="base")
        if bar.height > LOW:
            ax.axhline(bar.height, color=BOUND, ls="--", label=f"highest bar, {bar.height:.2f} m")
        ax.axhline(0.40, color=FAINT, ls=":", label="published cable, 0.40 m")
        ax.axhline(0.52, color=FAINT, ls="-.", label="published apex, 0.52 m")
        ax.set_ylabel("height [m]")
        ax.set_ylim(0, None)
        ax.set_title(title)
        ax.legend(loc="upper left", fontsize=7)
        with whole_file(path) as temporary:
            figure.savefig(temporary, dpi=130)


def _torques(path: Path, title: str, episode: simulation.OnlineEpisode, roll: Roll) -> None:
    with rc_context(RC):
        figure = Figure(figsize=(6.5, 5.0), layout="constrained")
        axes = _shaded(figure, len(KINDS), roll)
        near = (episode.times >= roll.begins - 0.6) & (episode.times <= roll.ends + 0.6)
        for k, (ax, kind) in enumerate(zip(axes, KINDS, strict=True)):
            for leg, name in enumerate(episode.robot.foot_names):
                ax.plot(episode.times[near], episode.torques[near, 3 * leg + k], color=LEGS[leg], lw=0.8, label=name)
            for sign in (-1, 1):
                ax.axhline(sign * episode.torque_limit[k], color=BOUND, ls="--", lw=0.8)
            ax.set_ylabel(f"{kind} [Nm]")
        axes[0].set_title(title)
        axes[0].legend(ncols=4, fontsize=7, loc="lower left")
        with whole_file(path) as temporary:
            figure.savefig(temporary, dpi=130)
