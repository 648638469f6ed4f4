"""Tables of a study: the results of every cell, success over terrains and horizons, and violations of constraints."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from piaffe.files import write_whole

Row = Mapping[str, Any]

_MISSED = "missed_percent."
AXES = ("terrain", "horizon", "samples", "temperature", "value")
"""Order of the settings in tables and figures; all other settings that vary come after these."""

_ALWAYS = ("terrain", "horizon", "samples")
_FIXED = frozenset({"label", "cell", "seed", "threads"})


def cells(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return one row per cell: its settings, and statistics over its seeds."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["label"], row["cell"]), []).append(row)
    return [_cell(group) for group in groups.values()]


def varied(rows: Sequence[Row]) -> list[str]:
    """Return the settings that differ between rows of a study, without those that the label determines."""
    names = dict.fromkeys(name for row in rows for name in _settings(row))
    settings = [name for name in names if len({str(row.get(name)) for row in rows}) > 1]
    labels = len({row["label"] for row in rows})
    pairs = {name: len({(row["label"], str(row.get(name))) for row in rows}) for name in settings}
    settings = [name for name in settings if name in _ALWAYS or pairs[name] > labels]
    return sorted(settings, key=lambda name: AXES.index(name) if name in AXES else len(AXES))


def write_tables(folder: Path, rows: Sequence[Row]) -> list[Path]:
    """Write all tables that can be made from the rows, as Markdown and CSV, and return their paths.

    Args:
        folder: folder of the tables.
        rows: rows of :meth:`piaffe.sampling.Study.rows`.
    """
    found = cells(rows)
    settings = varied(rows)
    tables = {"cells": [_listed(cell, settings) for cell in found]}
    if "terrain" in settings or "horizon" in settings:
        tables["success"] = _over_terrains(found)
    if constraints(rows):
        tables["violation"] = [
            {"method": cell["label"], **{name: text_of(cell.get(name)) for name in settings},
             **{name: f"{cell[_MISSED + name]:.2f}" for name in constraints(rows) if _MISSED + name in cell}}
            for cell in found
        ]  # fmt: skip
    return [path for name, lines in tables.items() for path in write_table(folder / name, lines)]


def listed(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Return every cell as strings, by column."""
    return [_listed(cell, varied(rows)) for cell in cells(rows)]


def write_table(path: Path, lines: Sequence[Mapping[str, str]]) -> list[Path]:
    """Write lines with the same columns as ``PATH.md`` and ``PATH.csv``; return both paths."""
    names = list(dict.fromkeys(name for line in lines for name in line))
    cells = [[line.get(name, "") for name in names] for line in lines]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([names, *cells])
    rule = ["---"] * len(names)
    markdown = "\n".join(f"| {' | '.join(line)} |" for line in [names, rule, *cells]) + "\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    paths = [path.with_suffix(".md"), path.with_suffix(".csv")]
    for file, content in zip(paths, (markdown, text.getvalue()), strict=True):
        write_whole(file, content.encode())
    return paths


def constraints(rows: Sequence[Row]) -> list[str]:
    """Return the names of all constraints."""
    return list(dict.fromkeys(name.removeprefix(_MISSED) for row in rows for name in row if name.startswith(_MISSED)))


def _settings(row: Row) -> list[str]:
    """Return the names of a row's settings: those before its figures."""
    names = list(row)
    end = next(i for i, name in enumerate(names) if name in ("dt_s", "seeds"))
    return [name for name in names[:end] if name not in _FIXED]


def _cell(group: Sequence[Row]) -> dict[str, Any]:
    first = group[0]
    missed = {name: float(np.mean([row[_MISSED + name] for row in group])) for name in constraints(group)}
    rewards = _known(group, "mean_reward")
    errors = [100 * each for each in _known([row for row in group if not row["fell"]], "speed_error")]
    return {
        "label": first["label"], **{name: first[name] for name in _settings(first)},
        "seeds": len(group),
        "success_percent": 100 * float(np.mean([row["success"] for row in group])),
        "falls": sum(row["fell"] for row in group),
        "mean_reward": _over(np.mean, rewards),
        "reward_error": float(np.std(rewards, ddof=1) / np.sqrt(len(group))) if len(rewards) > 1 else 0.0,
        "missed_percent_worst": max(missed.values(), default=0.0) if rewards else None,
        "speed_error_m_per_s": _over(np.mean, _known(group, "speed_error_m_per_s")),
        "speed_error_percent": _over(np.median, errors),
        "speed_error_percent_worst": _over(np.max, errors),
        "plan_ms_median": _over(np.median, _known(group, "plan_ms_median")),
        "tick_us_median": _over(np.median, _known(group, "tick_us_median")),
        **{name: _over(np.sum, _known(group, name)) for name in ("relaxed", "fallbacks")},
        "effective_samples_median": _over(np.median, _known(group, "effective_samples_median")),
        **{_MISSED + name: value for name, value in missed.items()},
    }  # fmt: skip


def _listed(cell: Row, settings: Sequence[str]) -> dict[str, str]:
    return {
        "method": cell["label"], **{name: text_of(cell.get(name)) for name in settings},
        "seeds": str(cell["seeds"]), "success [%]": f"{cell['success_percent']:.0f}",
        "falls": str(cell["falls"]),
        **{column: form.format(cell[name]) for column, (name, form) in _FIGURES.items() if cell.get(name) is not None},
    }  # fmt: skip


_FIGURES = {
    "mean step reward": ("mean_reward", "{:.4f}"),
    "worst violation [%]": ("missed_percent_worst", "{:.2f}"),
    "speed error [m/s]": ("speed_error_m_per_s", "{:.3f}"),
    "speed error [%]": ("speed_error_percent", "{:.1f}"),
    "worst [%]": ("speed_error_percent_worst", "{:.1f}"),
    "ms per plan": ("plan_ms_median", "{:.1f}"),
    "us per tick": ("tick_us_median", "{:.0f}"),
    "relaxed": ("relaxed", "{:.0f}"),
    "fallbacks": ("fallbacks", "{:.0f}"),
    "effective samples": ("effective_samples_median", "{:.1f}"),
}
"""Columns of a table, each with the entry of a cell and its form; what no cell has is left out."""


def _known(group: Sequence[Row], name: str) -> list[float]:
    """Return the values of an entry, of the rows that have it."""
    return [row[name] for row in group if row.get(name) is not None]


def _over(figure: Callable[[Any], Any], values: Sequence[float]) -> float | None:
    return float(figure(values)) if len(values) else None


def _over_terrains(found: Sequence[Row]) -> list[dict[str, str]]:
    """Return a line per method: success [%] / violation [%] of its worst constraint, by terrain and horizon."""
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    others = [name for name in varied(found) if name not in ("terrain", "horizon")] if len(found) > 1 else []
    for cell in found:
        own = {name: text_of(cell.get(name)) for name in others}
        line = lines.setdefault((cell["label"], *own.values()), {"method": cell["label"], **own})
        column = f"{cell.get('terrain', '')} H = {cell['horizon']}".strip() if "horizon" in cell else "all"
        missed = cell["missed_percent_worst"]
        line[column] = f"{cell['success_percent']:.0f}" + ("" if missed is None else f" / {missed:.1f}")
    return list(lines.values())


def text_of(value: Any) -> str:
    """Return a setting as a string; for a path, the name of the file."""
    if value is None:
        return "-"
    return Path(value).name if isinstance(value, str) and "/" in value else str(value)
