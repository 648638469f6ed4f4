"""The figure of a solution: contacts, base, joints, torques, forces with their cones, defects and convergence."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from piaffe.errors import FileFormatError

from .curves import Panel, feet_of, forces, friction, panels, stance_feet
from .playback import caption
from .style import AXES, BOUND, FAINT, FLIGHT, INK, LEGS, NEUTRAL, RC, SHADES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from piaffe.solvers import Solution

Array = NDArray[np.float64]

COLUMNS = 4
_SMALLEST = 0.02  # [m], [rad], ...: the least that a robot's diagram spans
_TERMS = 9  # more do not fit


def plot(solution: Solution, path: Path, *, title: str = "", dpi: int = 150) -> Path:
    """Draw a solution into an image or PDF file; return its path.

    Args:
        solution: what to draw.
        path: the file; its ending chooses the format.
        title: what stands above; by default the robot's or model's name.
        dpi: pixels per inch.
    """
    known = FigureCanvasAgg.get_supported_filetypes()
    if path.suffix.removeprefix(".") not in known:
        raise FileFormatError(
            f"file '{path}': unknown kind of picture - got '{path.suffix}', expected '.png', '.pdf' or "
            "'.svg'; change the ending"
        )
    with rc_context(RC):
        figure = draw(solution, title)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=dpi)
    return path


def draw(solution: Solution, title: str = "") -> Figure:
    """Return the figure of a solution."""
    with rc_context(RC):
        return _draw(solution, title)


def _draw(solution: Solution, title: str) -> Figure:
    shown, feet = panels(solution), feet_of(solution)
    cells: list[Any] = [*shown]
    if feet:
        cells = _interleave(shown, [_normal_forces, _cone, _cone_use])
    cells += [_defects, _cost, _violations, _terms]
    rows = -(-len(cells) // COLUMNS)
    layout = ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.045, hspace=0.03, wspace=0.02)
    figure = Figure(figsize=(3.5 * COLUMNS, 0.75 + 1.9 * rows + (0.3 + 0.17 * len(feet))), layout=layout)
    grid = GridSpec(rows + 1, COLUMNS, figure=figure, height_ratios=[0.16 + 0.115 * max(len(feet), 1), *[1.0] * rows])
    strip = figure.add_subplot(grid[0, :])
    _contacts(strip, solution, feet)
    for i, cell in enumerate(cells):
        axes = figure.add_subplot(grid[1 + i // COLUMNS, i % COLUMNS])
        if isinstance(cell, Panel):
            _time(axes, solution)
            _panel(axes, cell)
        else:
            cell(axes, solution)
        below = cells[i + COLUMNS] if i + COLUMNS < len(cells) else None
        if _over_time(cell) and not _over_time(below):
            axes.set_xlabel("time [s]", labelpad=1)
    name = title or " + ".join(dict.fromkeys(part.model for part in solution.trajectory.phases))
    figure.suptitle(
        f"{name}   ·   {solution.trajectory.duration:.2f} s   ·   cost {solution.cost:.4g}   ·   "
        f"{solution.status.name.lower().replace('_', ' ')} after {solution.iterations} iterations, "
        f"{solution.wall_s:.1f} s",
        x=0.012, ha="left", fontsize=11, color=INK,
    )  # fmt: skip
    figure.text(0.995, 0.995, "dotted: asked for   ·   dashed: limit", ha="right", va="top", fontsize=8.5, color=FAINT)
    return figure


def _interleave(shown: Sequence[Panel], further: Sequence[Any]) -> list[Any]:
    """Return panels row by row: rows of three joint panels get a panel of forces as their fourth."""
    base = [panel for panel in shown if not _is_joint(panel)]
    joints = [panel for panel in shown if _is_joint(panel)]
    if len(joints) != 9:
        return [*base, *joints, *further]
    rows: list[Any] = list(base)
    for row, extra in enumerate(further):
        rows += [*joints[3 * row : 3 * row + 3], extra]
    return rows


def _over_time(cell: object) -> bool:
    return isinstance(cell, Panel) or cell in (_normal_forces, _cone_use, _defects)


def _is_joint(panel: Panel) -> bool:
    return panel.title.endswith(("angle", "speed", "torque"))


# ---- what panels share


def _time(axes: Axes, solution: Solution) -> None:
    """Shade the phases and set the time axis."""
    parts = solution.trajectory.phases
    for i, part in enumerate(parts):
        axes.axvspan(part.times[0], part.times[-1], color=_shade(solution, i), lw=0, zorder=0)
    axes.set_xlim(parts[0].times[0], parts[-1].times[-1])
    axes.tick_params(labelsize=7.5)


def _shade(solution: Solution, i: int) -> str:
    part = solution.trajectory.phases[i]
    return FLIGHT if feet_of(solution) and part.mode in ("", "flight") else SHADES[i % 2]


def _panel(axes: Axes, panel: Panel) -> None:
    for curve in panel.curves:
        style = "steps-post" if curve.held else "default"
        axes.plot(curve.times, curve.values, color=curve.colour, label=curve.label, drawstyle=style)
    low, high = axes.get_ylim()
    if panel.unit and high - low < _SMALLEST:  # what a robot cannot do is not worth a diagram's height
        low, high = 0.5 * (low + high - _SMALLEST), 0.5 * (low + high + _SMALLEST)
    for curve in panel.curves:
        if curve.target is not None:
            axes.plot(curve.times, curve.target, color=curve.colour, lw=0.9, ls=(0, (1, 1.6)), alpha=0.75, zorder=1.5)
    for lower, upper in panel.bounds:
        for bound, sign in ((lower, -1), (upper, 1)):
            if bound is None:
                continue
            near = sign * bound - sign * (high if sign > 0 else low) < 0.5 * (high - low)
            if near or panel.curves[0].held:  # limits of controls are always shown
                low, high = min(low, bound), max(high, bound)
                axes.axhline(bound, color=BOUND, lw=0.8, ls=(0, (4, 2)), zorder=1)
    margin = 0.05 * (high - low)
    axes.set_ylim(low - margin, high + margin)
    axes.set_title(panel.title)
    axes.set_ylabel(f"[{panel.unit}]" if panel.unit else "")
    if panel.legend:
        _legend(axes, len(panel.curves))


def _legend(axes: Axes, columns: int) -> None:
    """Put the legend above the diagram, at the right of its title."""
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.97), borderaxespad=0.0, ncols=min(columns, 6), handletextpad=0.4,
        handlelength=1.0, columnspacing=0.9,
    )  # fmt: skip


# ---- contacts


def _contacts(axes: Axes, solution: Solution, feet: Sequence[str]) -> None:
    """Draw phase names and, for robots, one bar per foot while it is on the ground."""
    parts = solution.trajectory.phases
    start, end = parts[0].times[0], parts[-1].times[-1]
    times, force = forces(solution) if feet else (np.zeros(0), np.zeros((0, 0, 3)))
    for i, part in enumerate(parts):
        axes.axvspan(part.times[0], part.times[-1], color=_shade(solution, i), lw=0, zorder=0)
        axes.axvline(part.times[0], color="#C3C8D0", lw=0.7, zorder=1)
        name = caption(part)
        wide = part.duration / (end - start) > 0.006 * max(len(name), 3)
        axes.text(
            part.times[0] + 0.5 * part.duration, 1.02, name, transform=axes.get_xaxis_transform(), ha="center",
            va="bottom", fontsize=8.5 if wide else 6.5, rotation=0 if wide else 35, color=INK,
        )  # fmt: skip
        down = stance_feet(part, feet) if feet else []
        for row, foot in enumerate(feet):
            for first, last in _spans(part, foot, down, times, force[:, row] if feet else force):
                axes.barh(row, last - first, left=first, height=0.62, color=LEGS[row % len(LEGS)], zorder=2)
    axes.set_xlim(start, end)
    axes.set_ylim(len(feet) - 0.4 if feet else 1, -0.6)
    axes.set_yticks(range(len(feet)), feet)
    axes.grid(visible=False)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("time [s]", labelpad=1)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    changes = [p.times[0] for q, p in pairwise(parts) if p.model != q.model]
    for time in changes:
        axes.axvline(time, color=INK, lw=1.2, zorder=3)


def _spans(part: Any, foot: str, down: Sequence[str] | None, times: Array, force: Array) -> list[tuple[float, float]]:
    """Return when a foot is on the ground in a phase: all of it or, in modes without contact sets, while it pushes."""
    if down is not None:
        return [(part.times[0], part.times[-1])] if foot in down else []
    return [
        (a, b) for a, b in pairwise(part.times)
        if np.any(np.abs(force[np.searchsorted(times, a + 1e-9) - 1]) > 1e-6)
    ]  # fmt: skip


# ---- forces


def _normal_forces(axes: Axes, solution: Solution) -> None:
    _time(axes, solution)
    times, force = forces(solution)
    for i, foot in enumerate(feet_of(solution)):
        axes.plot(times, force[:, i, 2], color=LEGS[i % len(LEGS)], drawstyle="steps-post", label=foot)
    axes.set_title("Normal force")
    axes.set_ylabel("[N]")


def _cone(axes: Axes, solution: Solution) -> None:
    """Draw tangential against normal force, with the friction cone."""
    _, force = forces(solution)
    normal = force[..., 2]
    pushing = np.abs(force).max(axis=-1) > 1e-6
    for i in range(force.shape[1]):
        on = pushing[:, i]
        axes.plot(force[on, i, 0], normal[on, i], ".", ms=3.2, color=LEGS[i % len(LEGS)], alpha=0.85)
        axes.plot(force[on, i, 1], normal[on, i], "+", ms=3.6, mew=0.8, color=LEGS[i % len(LEGS)], alpha=0.85)
    mu, top = friction(solution), float(np.nanmax(normal, initial=1.0)) * 1.08
    if mu is not None:
        axes.plot([-mu * top, 0, mu * top], [top, 0, top], color=BOUND, lw=0.9, ls=(0, (4, 2)), zorder=1)
        axes.fill([-mu * top, 0, mu * top], [top, 0, top], color="#EAF3EC", zorder=0.5, lw=0)
        axes.text(0, top, f"μ = {mu:g}", ha="center", va="top", color=FAINT, fontsize=8)
    axes.set_ylim(-0.04 * top, top)
    axes.set_title("Friction cone")
    axes.set_xlabel("$F_x$ (·), $F_y$ (+) [N]", labelpad=1)
    axes.set_ylabel("$F_z$ [N]")
    axes.tick_params(labelsize=7.5)


def _cone_use(axes: Axes, solution: Solution) -> None:
    """Draw the larger tangential component over the largest that friction holds."""
    _time(axes, solution)
    times, force = forces(solution)
    mu = friction(solution) or 1.0
    for i in range(force.shape[1]):
        pushing = force[:, i, 2] > 1e-3
        use = np.full(len(times), np.nan)
        use[pushing] = np.abs(force[pushing, i, :2]).max(axis=1) / (mu * force[pushing, i, 2])
        axes.plot(times, use, color=LEGS[i % len(LEGS)], drawstyle="steps-post")
    axes.axhline(1.0, color=BOUND, lw=0.8, ls=(0, (4, 2)), zorder=1)
    axes.set_ylim(0, 1.15)
    axes.set_title("Use of friction  max(|$F_x$|, |$F_y$|) / μ$F_z$" if friction(solution) else "Slope of the force")
    axes.set_ylabel("[-]")


# ---- how well it is solved


def _defects(axes: Axes, solution: Solution) -> None:
    _time(axes, solution)
    for part, policy in zip(solution.trajectory.phases, solution.phases, strict=True):
        size = np.maximum(np.max(np.abs(policy.defects), axis=1, initial=0.0), 1e-16)
        axes.semilogy(part.times[1:], size[1:], color=NEUTRAL, lw=1.0)
        axes.semilogy(part.times[:1], size[:1], "D", ms=3.2, color=AXES[0], zorder=3)
    axes.axhline(1e-4, color=BOUND, lw=0.8, ls=(0, (4, 2)), zorder=1)
    axes.set_ylim(bottom=max(axes.get_ylim()[0], 1e-16))
    axes.set_title("Defects (◆ at phase starts)")
    axes.set_ylabel("∞-norm")


def _history(axes: Axes) -> None:
    axes.set_xlabel("iteration", labelpad=1)
    axes.tick_params(labelsize=7.5)
    axes.margins(x=0.01)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _cost(axes: Axes, solution: Solution) -> None:
    _history(axes)
    iterations = [record.iteration for record in solution.history]
    axes.plot(iterations, [record.cost for record in solution.history], color=LEGS[0])
    axes.set_title("Cost")
    costs = np.array([record.cost for record in solution.history])
    if costs.size and costs.min() > 0 and costs.max() > 30 * costs.min():
        axes.set_yscale("log")


def _violations(axes: Axes, solution: Solution) -> None:
    _history(axes)
    iterations = [record.iteration for record in solution.history]
    kinds = (("defect", "defect", NEUTRAL), ("equality", "eq.", LEGS[0]), ("inequality", "ineq.", LEGS[1]))
    for name, label, colour in kinds:
        values = np.array([getattr(record, f"max_{name}") for record in solution.history])
        if np.any(values > 0):
            axes.semilogy(iterations, np.where(values > 0, values, np.nan), color=colour, label=label)
    axes.set_title("Violations")
    if axes.get_legend_handles_labels()[0]:
        _legend(axes, 3)


def _terms(axes: Axes, solution: Solution) -> None:
    """Draw what each term cost, the dearest on top."""
    costs = sorted(((cost, name) for name, cost in solution.term_costs.items()), reverse=True)
    shown = costs[:_TERMS]
    if len(costs) > _TERMS:
        shown = [*costs[: _TERMS - 1], (sum(cost for cost, _ in costs[_TERMS - 1 :]), "others")]
    axes.barh(range(len(shown)), [cost for cost, _ in shown], height=0.66, color="#B9C9DC", zorder=2)
    for row, (_, name) in enumerate(shown):
        axes.text(
            0.015, row, name, transform=axes.get_yaxis_transform(), va="center", fontsize=7.5, color=INK, zorder=3
        )
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.set_yticks([])
    axes.grid(axis="y", visible=False)
    axes.tick_params(labelsize=7.5)
    axes.set_title("Cost by term")
