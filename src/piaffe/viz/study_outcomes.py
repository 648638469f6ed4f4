"""The figure of a study's cells with a receding horizon: success and speed by setting and method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from piaffe.sampling import text_of, varied

from .style import RC, colours

Row = Mapping[str, Any]

_MOST = 12  # more groups of bars cannot be read


def outcomes(found: Sequence[Row]) -> Figure | None:
    """Return the figure; None if there are no such cells, or too many settings.

    Args:
        found: the cells.
    """
    shown = [cell for cell in found if cell.get("tick_us_median") is not None]
    if len(shown) < 2:
        return None
    names = varied(shown)
    groups = list(dict.fromkeys(_group(cell, names) for cell in shown))
    labels = list(dict.fromkeys(cell["label"] for cell in shown))
    if len(groups) > _MOST:
        return None
    with rc_context(RC):
        figure = Figure(figsize=(max(4.5, 1.5 * len(groups) + 1.5), 5.2), layout="constrained")
        success, speed = figure.subplots(2, 1, sharex=True)
        width = 0.8 / len(labels)
        for i, (label, colour) in enumerate(zip(labels, colours(len(labels)), strict=True)):
            own = [cell for cell in shown if cell["label"] == label]
            at = np.array([groups.index(_group(cell, names)) for cell in own]) + width * (i - (len(labels) - 1) / 2)
            percent = [cell["success_percent"] for cell in own]
            success.bar(at, percent, 0.92 * width, color=colour, label=label)
            for x, value in zip(at, percent, strict=True):
                success.annotate(
                    f"{value:.0f}", (x, value), xytext=(0, 2), textcoords="offset points", ha="center", fontsize=7
                )
            median, worst = (
                np.array([cell[name] for cell in own], dtype=float)
                for name in ("speed_error_percent", "speed_error_percent_worst")
            )
            speed.bar(at, median, 0.92 * width, color=colour)
            speed.plot(at, worst, "_", ms=9, mew=1.4, color=colour)
        success.set_ylim(0, 112)
        success.set_yticks(range(0, 101, 25))
        success.set_ylabel("success [%]")
        success.legend(loc="lower left", bbox_to_anchor=(0, 1.01), borderaxespad=0, ncols=len(labels))
        speed.set_ylim(bottom=0)
        speed.set_ylabel("speed error without falls [%]:\nmedian, worst (line)")
        speed.set_xticks(range(len(groups)), groups)
        for ax in (success, speed):
            ax.grid(visible=False, axis="x")
    return figure


def _group(cell: Row, names: Sequence[str]) -> str:
    """Return the settings of a cell that differ between cells, as a text."""
    return "\n".join(f"{name} {text_of(cell.get(name)) or 'none'}" for name in names) or "all"
