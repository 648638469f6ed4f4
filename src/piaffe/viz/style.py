"""Colours and fonts of figures and films."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

LEGS = ("#0072B2", "#E69F00", "#009E73", "#CC3E6B", "#7B5EA7", "#56B4E9", "#8C6D31", "#555555")
"""One colour per foot, in the robot's order; people with red-green colour blindness can distinguish them."""

AXES = ("#C8442B", "#2E8B57", "#2F5FA8")
"""x, y, z; roll, pitch, yaw."""

INK, FAINT, BOUND = "#222222", "#8A8F98", "#B3261E"
SHADES = ("#EEF1F5", "#FFFFFF")
FLIGHT = "#FFF6E0"
NEUTRAL = "#5B6270"

RC: Any = {  # keys as matplotlib names them
    "font.size": 8.5,
    "font.family": "DejaVu Sans",
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.edgecolor": "#9AA0A8",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.formatter.useoffset": False,
    "grid.color": "#D9DDE3",
    "grid.linewidth": 0.5,
    "xtick.color": "#5B6270",
    "ytick.color": "#5B6270",
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "lines.linewidth": 1.3,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "legend.handlelength": 1.4,
    "legend.columnspacing": 1.2,
    "legend.borderaxespad": 0.2,
    "figure.facecolor": "white",
}


def colours(count: int, palette: Sequence[str] = LEGS) -> list[str]:
    """Return a number of colours from a palette, which repeats."""
    return [palette[i % len(palette)] for i in range(count)]
