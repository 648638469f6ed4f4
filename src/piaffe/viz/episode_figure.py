"""The figure of episodes: motion, reward, planning time and violations over time, one line per seed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from piaffe.models import base
from piaffe.ocp import rotation
from piaffe.sampling import Trial
from piaffe.simulation import Episode

from .figure import require_picture, save_figure
from .style import BOUND, LEGS, NEUTRAL, RC, colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_episodes(path: Path, trial: Trial, episodes: Mapping[int, Episode]) -> Path:
    """Draw episodes into an image or PDF file, and return its path.

    Args:
        path: the file; its suffix selects the format.
        trial: the trial.
        episodes: its episodes by seed.
    """
    require_picture(path)
    with rc_context(RC):
        figure = Figure(figsize=(10.5, 7.2), layout="constrained")
        axes = figure.subplots(3, 2, sharex="col")
        for episode in episodes.values():
            _motion(axes[:, 0], trial, episode)
            _control(axes[:2, 1], episode)
        _violations(axes[2, 1], list(episodes.values()))
        for ax in axes[-1]:
            ax.set_xlabel("time [s]")
        won = sum(episode.success for episode in episodes.values())
        controller = trial.controller
        figure.suptitle(
            f"{controller.title}   ·   H = {controller.steps}, {controller.options.samples} samples"
            f"   ·   success in {won} of {len(episodes)}",
            x=0.012, ha="left", fontsize=11,
        )  # fmt: skip
        return save_figure(figure, path)


def _motion(axes: Any, trial: Trial, episode: Episode) -> None:
    model = trial.controller.model
    speed = episode.states[:, model.state.slices[base.linear_velocity]]
    upright = rotation.np_matrix(episode.states[:, model.state.slices[base.orientation]])[:, 2, 2]
    curves = (
        ("forward speed", "m/s", speed[:, 0]),
        ("height of the base above the ground", "m", model.height_above_terrain(episode.states)),
        ("tilt of the base", "rad", np.arccos(np.clip(upright, -1.0, 1.0))),
    )
    for ax, (title, unit, values) in zip(axes, curves, strict=True):
        _line(ax, episode.times, values, episode.fell)
        ax.set_title(title)
        ax.set_ylabel(f"[{unit}]")


def _control(axes: Any, episode: Episode) -> None:
    times = episode.times[:-1]
    for ax, title, values in zip(
        axes, ("reward", "time per plan [ms]"), (episode.reward, episode.plan_ms), strict=True
    ):
        _line(ax, times, values, episode.fell)
        ax.set_title(title)


def _line(ax: Axes, times: Any, values: Any, fell: bool) -> None:
    ax.plot(times, values, color=BOUND if fell else LEGS[0], lw=0.9, alpha=0.6)


def _violations(ax: Axes, episodes: list[Episode]) -> None:
    """Draw the violation of each constraint (its worst row), as mean over the episodes that have not ended."""
    longest = max(episodes, key=lambda episode: len(episode.actions))
    names = list(dict.fromkeys(longest.constraints))
    times = longest.times[:-1]
    for name, colour in zip(names, colours(len(names)), strict=True):
        rows = np.full((len(episodes), len(times)), np.nan)
        for row, episode in zip(rows, episodes, strict=True):
            own = np.array(episode.constraints) == name
            row[: len(episode.actions)] = episode.violation[own].max(axis=0)
        ax.plot(times, 100 * np.nanmean(rows, axis=0), color=colour, lw=1.0, label=name)
    ax.set_title("violation, mean over seeds [%]")
    if names:
        ax.legend(fontsize=7)
    else:
        ax.text(0.5, 0.5, "no constraints", transform=ax.transAxes, ha="center", color=NEUTRAL)
