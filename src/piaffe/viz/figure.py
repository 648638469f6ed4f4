"""The figure of a solution: contacts, base, joints, torques, forces with their cones, defects and convergence."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import NDArray

from piaffe.errors import FileFormatError
from piaffe.files import write_whole
from piaffe.ocp import SAME_TIME

from .curves import Panel, feet_of, forces, panels, stance_feet
from .diagrams import cone, cone_use, cost, defects, draw_panel, normal_forces, over_time, shade, terms, violations
from .playback import caption
from .style import FAINT, INK, LEGS, RC

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from piaffe.solvers import Solution

Array = NDArray[np.float64]

COLUMNS = 4


@overload
def plot(solution: Solution, *, title: str = "") -> Figure: ...
@overload
def plot(solution: Solution, path: str | Path, *, title: str = "", dpi: int = 150) -> Path: ...
def plot(solution: Solution, path: str | Path | None = None, *, title: str = "", dpi: int = 150) -> Figure | Path:
    """Return the figure of a solution, or draw it into an image or PDF file and return the path.

    Args:
        solution: the solution.
        path: the file; its suffix selects the format. None for the figure itself.
        title: title of the figure; by default the names of the models.
        dpi: pixels per inch.
    """
    if path is None:
        return draw(solution, title)
    require_picture(Path(path))
    with rc_context(RC):
        return save_figure(draw(solution, title), Path(path), dpi)


def save_figure(figure: Figure, path: Path, dpi: int = 150) -> Path:
    """Write a figure into a file, atomically; return its path."""
    content = BytesIO()
    with rc_context(RC):
        figure.savefig(content, dpi=dpi, format=path.suffix.removeprefix(".") or "png")
    write_whole(path, content.getvalue())
    return path


def require_picture(path: Path) -> None:
    """Raise FileFormatError if a file does not have the suffix of a picture."""
    known = FigureCanvasAgg.get_supported_filetypes()
    if path.suffix.removeprefix(".") not in known:
        raise FileFormatError(
            f"file '{path}': unknown kind of picture - got '{path.suffix}', expected '.png', '.pdf' or "
            "'.svg'; change the ending"
        )


def draw(solution: Solution, title: str = "") -> Figure:
    """Return the figure of a solution."""
    with rc_context(RC):
        return _draw(solution, title)


def _draw(solution: Solution, title: str) -> Figure:
    shown, feet = panels(solution), feet_of(solution)
    cells: list[Any] = [*shown]
    if feet:
        cells = _interleave(shown, [normal_forces, cone, cone_use])
    cells += [defects, cost, violations, terms]
    rows = -(-len(cells) // COLUMNS)
    layout = ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.045, hspace=0.03, wspace=0.02)
    figure = Figure(figsize=(3.5 * COLUMNS, 0.75 + 1.9 * rows + (0.3 + 0.17 * len(feet))), layout=layout)
    grid = GridSpec(rows + 1, COLUMNS, figure=figure, height_ratios=[0.16 + 0.115 * max(len(feet), 1), *[1.0] * rows])
    strip = figure.add_subplot(grid[0, :])
    _contacts(strip, solution, feet)
    for i, cell in enumerate(cells):
        axes = figure.add_subplot(grid[1 + i // COLUMNS, i % COLUMNS])
        if isinstance(cell, Panel):
            over_time(axes, solution)
            draw_panel(axes, cell)
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
    figure.text(0.995, 0.995, "dotted: target   ·   dashed: limit", ha="right", va="top", fontsize=8.5, color=FAINT)
    return figure


def _interleave(shown: Sequence[Panel], further: Sequence[Any]) -> list[Any]:
    """Return panels row by row: each row of three joint panels gets one of ``further`` as its fourth panel."""
    base = [panel for panel in shown if not _is_joint(panel)]
    joints = [panel for panel in shown if _is_joint(panel)]
    if len(joints) != 9:
        return [*base, *joints, *further]
    rows: list[Any] = list(base)
    for row, extra in enumerate(further):
        rows += [*joints[3 * row : 3 * row + 3], extra]
    return rows


def _over_time(cell: object) -> bool:
    return isinstance(cell, Panel) or cell in (normal_forces, cone_use, defects)


def _is_joint(panel: Panel) -> bool:
    return panel.title.endswith(("angle", "speed", "torque"))


# ---- contacts


def _contacts(axes: Axes, solution: Solution, feet: Sequence[str]) -> None:
    """Draw phase names and, for robots, bars for the times at which each foot is on the ground."""
    parts = solution.trajectory.phases
    start, end = parts[0].times[0], parts[-1].times[-1]
    times, force = forces(solution) if feet else (np.zeros(0), np.zeros((0, 0, 3)))
    for i, part in enumerate(parts):
        axes.axvspan(part.times[0], part.times[-1], color=shade(solution, i), lw=0, zorder=0)
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
    """Return spans [s] with a foot on the ground: the phase or, without contact sets, the stages with force on it."""
    if down is not None:
        return [(part.times[0], part.times[-1])] if foot in down else []
    return [
        (a, b) for a, b in pairwise(part.times)
        if np.any(np.abs(force[np.searchsorted(times, a + SAME_TIME) - 1]) > 1e-6)
    ]  # fmt: skip
