"""Small tables and curves in HTML, which notebooks show in place of an object's text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from math import isfinite, log10

ROWS = 24
"""A table shows this many rows at most."""


def html_table(title: str, head: Sequence[str], rows: Iterable[Sequence[object]], more: str = "") -> str:
    """Return a titled table; rows beyond ``ROWS`` are counted, not shown.

    Args:
        title: the line above it.
        head: names of the columns.
        rows: the cells; their text is escaped.
        more: HTML below the table.
    """
    all_rows = list(rows)
    lines = ["".join(f"<td>{escape(str(cell))}</td>" for cell in row) for row in all_rows[:ROWS]]
    if len(all_rows) > ROWS:
        lines.append(f'<td colspan="{len(head)}">and {len(all_rows) - ROWS} more</td>')
    names = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    table = f"<table><thead><tr>{names}</tr></thead><tbody>{body}</tbody></table>"
    return f"<div><b>{escape(title)}</b>{table}{more}</div>"


def html_curve(name: str, values: Sequence[float], width: int = 260, height: int = 60) -> str:
    """Return a curve of positive values over their index, on a logarithmic axis, as SVG; "" if none is finite."""
    points = [(i, log10(v)) for i, v in enumerate(values) if v > 0 and isfinite(v)]
    if len(points) < 2:
        return ""
    low, high = min(y for _, y in points), max(y for _, y in points)
    across, up = width / max(points[-1][0], 1), (height - 4) / ((high - low) or 1.0)
    line = " ".join(f"{x * across:.1f},{height - 2 - (y - low) * up:.1f}" for x, y in points)
    text = f"{name}, by iteration: {values[points[0][0]]:.3g} to {values[points[-1][0]]:.3g}, logarithmic"
    return (
        f'<figure style="margin:0"><svg width="{width}" height="{height}" role="img">'
        f'<polyline points="{line}" fill="none" stroke="currentColor"/></svg>'
        f"<figcaption>{escape(text)}</figcaption></figure>"
    )
