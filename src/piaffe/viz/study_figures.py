"""Figures of a study: reward and success over horizon and samples, and episodes over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, ScalarFormatter

from piaffe.models import joints
from piaffe.sampling import Case, Study, StudyFile, cells, text_of, varied
from piaffe.simulation import Episode

from .figure import save_figure
from .study_outcomes import outcomes
from .style import BOUND, RC, colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Row = Mapping[str, Any]

SWEPT = {"horizon": "horizon H [steps]", "samples": "samples N"}
HEIGHT = "height"
_COLUMNS = 4  # more episodes do not fit side by side


def draw_study(folder: Path, study: Study, file: StudyFile, rows: Sequence[Row]) -> list[Path]:
    """Draw the figures that the rows of a study allow, and return their paths.

    Args:
        folder: folder of the figures.
        study: the study with its episodes.
        file: the study's file, which lists the quantities to draw over time.
        rows: rows of the study.
    """
    found = cells(rows)
    saved = []
    terrains = list(dict.fromkeys(cell.get("terrain") for cell in found))
    for terrain in terrains:
        here = [cell for cell in found if cell.get("terrain") == terrain]
        lines = {axis: curves(here, axis) for axis in SWEPT}
        if any(lines.values()):
            name = "sweep" if len(terrains) == 1 else f"sweep-{terrain}"
            saved.append(save_figure(_sweep(lines, str(terrain) if len(terrains) > 1 else ""), folder / f"{name}.png"))
    if (figure := outcomes(found)) is not None:
        saved.append(save_figure(figure, folder / "outcomes.png"))
    if file.series:
        shown = _examples(study)
        if shown:
            saved.append(save_figure(_series(study, file, shown), folder / "series.png"))
    return saved


def curves(found: Sequence[Row], axis: str) -> dict[str, list[Row]]:
    """Return groups of cells that differ only in one setting, sorted by it: label of the curve → cells.

    Args:
        found: the cells.
        axis: the setting.
    """
    others = [name for name in varied(found) if name != axis]
    groups: dict[str, list[Row]] = {}
    for cell in found:
        values = ", ".join(f"{_SHORT.get(name, name)} = {text_of(cell.get(name))}" for name in others)
        groups.setdefault(f"{cell['label']}, {values}" if values else cell["label"], []).append(cell)
    return {
        name: sorted(group, key=lambda cell: cell[axis])
        for name, group in groups.items()
        if all(axis in cell for cell in group) and len({cell[axis] for cell in group}) > 1
    }


_STYLES = ("-", "--", ":", "-.")
_SHORT = {"horizon": "H", "samples": "N", "temperature": "λ"}


def _sweep(lines: Mapping[str, Mapping[str, Sequence[Row]]], title: str) -> Figure:
    """Return the figure of mean step reward and success over each varied setting."""
    axes_of = {axis: groups for axis, groups in lines.items() if groups}
    with rc_context(RC):
        figure = Figure(figsize=(5.2 * len(axes_of), 5.6), layout="constrained")
        grid = figure.subplots(2, len(axes_of), squeeze=False, sharex="col", sharey="row")
        labels = dict.fromkeys(group[0]["label"] for groups in axes_of.values() for group in groups.values())
        palette = dict(zip(labels, colours(len(labels)), strict=True))
        for column, (axis, groups) in enumerate(axes_of.items()):
            reward, success = grid[:, column]
            drawn: dict[str, int] = {}
            for name, group in groups.items():
                style = _STYLES[drawn.setdefault(group[0]["label"], 0) % len(_STYLES)]
                drawn[group[0]["label"]] += 1
                at = np.array([cell[axis] for cell in group])
                mean = np.array([cell["mean_reward"] for cell in group])
                error = np.array([cell["reward_error"] for cell in group])
                colour = palette[group[0]["label"]]
                reward.fill_between(at, mean - error, mean + error, color=colour, alpha=0.2, lw=0)
                reward.plot(at, mean, marker="o", ms=3.5, ls=style, color=colour, label=name)
                success.plot(
                    at, [cell["success_percent"] for cell in group], marker="o", ms=3.5, ls=style, color=colour
                )
            _ticks(success, axis, sorted({cell[axis] for group in groups.values() for cell in group}))
            reward.legend(loc="lower left", bbox_to_anchor=(0, 1.01), borderaxespad=0)  # outside the axes
        grid[0, 0].set_ylabel("mean step reward")
        grid[1, 0].set_ylabel("success [%]")
        grid[1, 0].set_ylim(-4, 104)
        figure.suptitle(title, x=0.012, ha="left", fontsize=11)
    return figure


def _ticks(axes: Axes, axis: str, values: Sequence[int]) -> None:
    axes.set_xlabel(SWEPT[axis])
    if axis == "samples":
        axes.set_xscale("log", base=2)
    axes.xaxis.set_major_locator(FixedLocator(list(values)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(ScalarFormatter())


# ---- over time


def _examples(study: Study) -> list[Case]:
    """Return the first finished episode of each method."""
    first: dict[str, Case] = {}
    for case in study.cases:
        if case.label not in first and study.kept(case):
            first.setdefault(case.label, case)
    return list(first.values())[:_COLUMNS]


def _series(study: Study, file: StudyFile, shown: Sequence[Case]) -> Figure:
    """Return the figure of quantities over time with their limits, one column per method."""
    with rc_context(RC):
        figure = Figure(figsize=(3.6 * len(shown), 2.1 * len(file.series) + 0.6), layout="constrained")
        grid = figure.subplots(len(file.series), len(shown), squeeze=False, sharex=True, sharey="row")
        for column, case in enumerate(shown):
            episode = study.episode(case)
            own = {name: case.settings[name] for name in file.declared.settings if name != "horizon"}
            model = file.declared.problem(own, case.settings["horizon"]).schedule.segments[0].model
            for row, (name, limit) in enumerate(file.series.items()):
                ax = grid[row, column]
                lines = _quantity(model, episode, name)
                for (label, values), colour in zip(lines.items(), colours(len(lines)), strict=True):
                    ax.plot(episode.times, values, color=colour, lw=0.9, label=label)
                for bound in (limit,) if name == HEIGHT else (-limit, limit):
                    ax.axhline(bound, color=BOUND, lw=0.9, ls=(0, (4, 2)))
                if column == 0:
                    ax.set_ylabel(f"{name} [{'m' if name == HEIGHT else 'rad'}]")
                if column == 0 and len(lines) > 1:
                    low, high = ax.get_ylim()
                    ax.set_ylim(low, high + 0.2 * (high - low))
                    ax.legend(ncols=4, fontsize=6.5, loc="upper left")
            grid[0, column].set_title(f"{case.label}, seed {case.seed}")
            grid[-1, column].set_xlabel("time [s]")
    return figure


def _quantity(model: Any, episode: Episode, name: str) -> dict[str, Any]:
    """Return values by label: the base's height above the ground, or the angles of joints with ``name`` in theirs."""
    if name == HEIGHT:
        return {"base": model.height_above_terrain(episode.states)}
    where = range(*model.state.slices[joints.position].indices(model.state.nx))
    return {
        joint: episode.states[:, i]
        for joint, i in zip(model.robot.joint_names, where, strict=True)
        if name.lower() in joint.lower()
    }
