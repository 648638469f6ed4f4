"""The figure of an episode of a receding horizon: base, command, torques, contacts, plans and ticks over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from piaffe.models import base
from piaffe.simulation import OnlineEpisode, stretches

from .figure import require_picture, save_figure
from .style import AXES, BOUND, FAINT, INK, LEGS, NEUTRAL, RC, colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PER_LEG = 3
_WHITE = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 0.8}


def plot_online(path: Path, episode: OnlineEpisode, *, title: str = "", result: str = "", settle: float = 2.0) -> Path:
    """Draw an episode into an image or PDF file, and return its path.

    Args:
        path: the file; its suffix selects the format.
        episode: the episode.
        title: what ran; by default the name of the robot.
        result: why it is no success; by default what the episode itself says.
        settle: time after each change of the command before the mean velocity is drawn [s].
    """
    require_picture(path)
    with rc_context(RC):
        figure = Figure(figsize=(13.0, 9.6), layout="constrained")
        axes = figure.subplots(4, 3, sharex=True)
        _base(axes[0], episode, settle)
        _height(axes[1, 0], episode)
        _contacts(axes[1, 1], episode)
        _loads(axes[1, 2], episode)
        _torques(axes[2], episode)
        _plans(axes[3], episode)
        _motions(axes, episode)
        for ax in axes[-1]:
            ax.set_xlabel("time [s]")
        if len(episode.times):
            axes[0, 0].set_xlim(episode.times[0], max(episode.end, episode.times[0] + 1e-3))
        bad = result or ("" if episode.success else episode.fault or "not upright at the end")
        figure.suptitle(
            f"{title or episode.robot.name}   ·   {episode.end:.2f} s   ·   {bad or 'success'}",
            x=0.012, ha="left", fontsize=11, color=BOUND if bad else INK,
        )  # fmt: skip
        figure.text(
            0.995, 0.995, "dotted: command   ·   thin: mean   ·   dashed: limit"
            + "   ·   grey: waits for the next motion" * bool(episode.plans.requests), ha="right", va="top",
            fontsize=8, color=FAINT,
        )  # fmt: skip
        return save_figure(figure, path)


def _motions(axes: NDArray[Any], episode: OnlineEpisode) -> None:
    """Mark changes of the motion: grey from the request on, a line and the name of the motion where it begins."""
    for ax in axes.flat:
        if episode.plans.requests:
            asked = np.array([bool(name) for name in episode.plans.requests])
            ax.fill_between(
                episode.plans.times, 0, 1, where=asked, step="post", transform=ax.get_xaxis_transform(),
                color=FAINT, alpha=0.2, lw=0, zorder=0,
            )  # fmt: skip
        for time, _ in episode.motions[1:]:
            ax.axvline(time, color=FAINT, lw=0.8, zorder=0.5)
    for time, name in episode.motions if len(episode.motions) > 1 else ():
        axes[1, 0].annotate(
            name, (time, 0.02), xycoords=axes[1, 0].get_xaxis_transform(), xytext=(2, 0), textcoords="offset points",
            fontsize=7, color=INK, bbox=_WHITE,
        )  # fmt: skip


def _base(axes: Sequence[Axes], episode: OnlineEpisode, settle: float) -> None:
    """Draw velocities with their command, and their means over each constant command after its ramp."""
    yaw_rate = np.gradient(episode.yaw, episode.times) if len(episode.times) > 1 else np.zeros(len(episode.times))
    measured = (episode.velocity[:, 0], episode.velocity[:, 1], yaw_rate)
    names = (("velocity ahead", "m/s"), ("velocity to the left", "m/s"), ("yaw rate", "rad/s"))
    for i, (ax, (name, unit), values) in enumerate(zip(axes, names, measured, strict=True)):
        ax.plot(episode.times, values, color=AXES[i], lw=0.9)
        ax.plot(episode.times, episode.commands[:, i], color=INK, ls=(0, (1, 1.6)), lw=1.2)
        _label(ax, name, unit)
    parts = stretches(episode.times, episode.commands, settle)
    for part, mean in zip(parts, episode.settled(settle), strict=True):
        for ax, value in zip(axes, (*mean.velocity, mean.yaw_rate), strict=True):
            ax.plot(episode.times[part][[0, -1]], [value, value], color=INK, lw=0.8)
            ax.annotate(
                f"{value:.3f}", (episode.times[part][-1], value), xytext=(-2, 3), textcoords="offset points",
                ha="right", fontsize=7, color=INK, bbox=_WHITE,
            )  # fmt: skip


def _height(ax: Axes, episode: OnlineEpisode) -> None:
    ax.plot(episode.times, episode.states[:, episode.space.slices[base.position]][:, 2], color=AXES[2], lw=0.9)
    _label(ax, "height of the base", "m")


def _contacts(ax: Axes, episode: OnlineEpisode) -> None:
    """Draw a strip per foot: planned contact above, measured below."""
    names = episode.robot.foot_names
    step = np.append(episode.times, episode.end)
    for row, (name, colour) in enumerate(zip(names, colours(len(names)), strict=True)):
        planned = np.nan_to_num(episode.planned[:, row]) > 0.5
        for flags, low, high, alpha in (
            (planned, row - 0.36, row, 0.4),
            (episode.touching[:, row], row, row + 0.36, 1),
        ):
            held = np.append(flags, flags[-1:])
            ax.fill_between(step, low, high, where=held, step="post", color=colour, alpha=alpha, lw=0, label=name)
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.grid(visible=False)
    ax.set_title("contacts: planned (pale), measured")


def _loads(ax: Axes, episode: OnlineEpisode) -> None:
    for row, (name, colour) in enumerate(zip(episode.robot.foot_names, colours(len(LEGS)), strict=False)):
        ax.plot(episode.times, episode.forces[:, row, 2], color=colour, lw=0.8, label=name)
    _label(ax, "normal forces", "N")
    _legend(ax)


def _torques(axes: Sequence[Axes], episode: OnlineEpisode) -> None:
    """Draw the torques of the joints in three diagrams, in the order of the robot, with their limits."""
    for ax, (title, own, labels) in zip(axes, _groups(episode.robot.joint_names), strict=True):
        for i, label, colour in zip(own, labels, colours(len(own)), strict=True):
            ax.plot(episode.times, episode.torques[:, i], color=colour, lw=0.7, label=label)
        for i in own:
            full = episode.limited[:, i]
            ax.plot(episode.times[full], episode.torques[full, i], ".", ms=3, color=BOUND, zorder=3)
        for limit in np.unique(episode.torque_limit[own]):
            for sign in (-1, 1):
                if np.isfinite(limit):
                    ax.axhline(sign * limit, color=BOUND, lw=0.8, ls=(0, (4, 2)))
        count = int(np.sum(episode.limited[:, own]))
        if count:
            ax.text(
                0.01, 0.12, f"red: at a limit, {count} times", transform=ax.transAxes, fontsize=7, color=BOUND,
                bbox=_WHITE,
            )  # fmt: skip
        _label(ax, title, "Nm")
        _legend(ax)


def _groups(names: Sequence[str]) -> list[tuple[str, list[int], list[str]]]:
    """Return three groups of joints: title, indices and labels.

    They are the first, second and third joint of every leg, else consecutive thirds. If all names of a group
    are as ``FL_HAA`` with one end, this is in the title and not in the labels.
    """
    count = len(names)
    if count % _PER_LEG == 0:
        groups = [list(range(i, count, _PER_LEG)) for i in range(_PER_LEG)]
    else:
        thirds: list[NDArray[np.int_]] = np.array_split(np.arange(count), _PER_LEG)
        groups = [[int(each) for each in own] for own in thirds]
    found = []
    for own in groups:
        labels = [names[i] for i in own]
        ends = {label.partition("_")[2] for label in labels}
        part = ends.pop() if len(ends) == 1 else ""
        short = [label.partition("_")[0] for label in labels]
        found.append((f"torques {part}" if part else "torques", own, short if part else labels))
    return found


def _plans(axes: Sequence[Axes], episode: OnlineEpisode) -> None:
    plans = episode.plans
    axes[0].plot(plans.times, 1e3 * plans.seconds, ".", ms=3, color=NEUTRAL, label="processor time")
    last = np.append(np.diff(episode.ages) < 0, True)[: len(episode.ages)]  # the last tick of every plan
    axes[0].plot(episode.times[last], 1e3 * episode.ages[last], ".", ms=3, color=LEGS[1], label="age at its last tick")
    axes[0].set_ylim(bottom=0)
    _label(axes[0], "plans", "ms")
    for ax in axes[1:]:
        ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes[1].plot(plans.times[1:], plans.iterations[1:], ".", ms=3, color=LEGS[0])
    axes[1].set_ylim(0, _above(plans.iterations[1:]))
    _label(axes[1], "iterations of a plan after the first", "")
    axes[2].plot(episode.times, episode.qp_iterations, ".", ms=2, color=LEGS[2])
    axes[2].set_ylim(0, _above(episode.qp_iterations))
    _label(axes[2], "iterations of the low level's quadratic program", "")
    _legend(axes[0])


def _above(values: Any) -> float:
    """Return the upper end of an axis for counts."""
    known = np.asarray(values, dtype=float)
    return 1.25 * float(np.max(known[np.isfinite(known)], initial=1.0))


def _label(ax: Axes, title: str, unit: str) -> None:
    ax.set_title(title)
    ax.set_ylabel(f"[{unit}]" if unit else "")


def _legend(ax: Axes) -> None:
    """Draw the legend above the diagram, at the right of its title."""
    ax.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.98), borderaxespad=0.0, ncols=4, fontsize=6.5, handlelength=1.0,
        columnspacing=0.8, handletextpad=0.4,
    )  # fmt: skip
