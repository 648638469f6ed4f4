"""Figures of the episodes of ``piaffe mpc``: a row per seed, a summary, and how they are printed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console

from piaffe.simulation import OnlineEpisode

from .online import OnlineSetup
from .online_settings import OnlineSettings
from .reports import new_table, plain

MEDIANS = (
    "speed_m_per_s", "speed_error", "rms_velocity_error_m_per_s", "plan_ms_median", "iterations_mean",
    "tick_us_median", "qp_iterations_mean", "limited",
)  # fmt: skip
"""Figures whose median over seeds is printed."""

WORST = (
    "speed_error", "rms_velocity_error_m_per_s", "plan_ms_p99", "tick_us_p99", "plan_age_ms_max", "qp_iterations_max",
    "slip_max_m_per_s", "torque_excess",
)  # fmt: skip
"""Figures whose largest value over seeds is printed."""


def online_row(seed: int, episode: OnlineEpisode, settings: OnlineSettings) -> dict[str, Any]:
    """Return the figures of an episode; None stands for what is not known.

    A *success* is an episode without a fall, with an upright base at its end (``stayed_upright``), whose speed after
    the ramp is within the bound for every constant command (``followed``; None after a fall, or if no command lasts
    long enough).

    Args:
        seed: its seed.
        episode: the episode.
        settings: what ran.
    """
    stretches = episode.settled(settings.settle)
    errors = [] if episode.fell else [each.speed_error for each in stretches if np.isfinite(each.speed_error)]
    whole = episode.end >= settings.settle + 0.5  # else the figures of tracking are those of the short episode
    row = episode.summary(settings.settle if whole else 0.0)
    row["stayed_upright"] = row.pop("success")
    row["speed_error"] = max(errors, default=None)
    row["followed"] = None if not errors else max(errors) <= settings.speed_bound
    row["stretches"] = [
        {"commanded_m_per_s": float(np.hypot(*each.commanded)), "speed_m_per_s": each.speed,
         "commanded_yaw_rate": each.commanded_yaw_rate, "yaw_rate": each.yaw_rate}
        for each in stretches
    ]  # fmt: skip
    return {"seed": seed, "success": row["stayed_upright"] and row["followed"] is not False, **row}


def online_values(setup: OnlineSetup, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the values that ``mpc --json`` prints: settings, figures over all seeds, and figures of each seed.

    Args:
        setup: what ran.
        rows: figures of its episodes.
    """
    return {
        "problem": str(setup.problem.source), "robot": setup.robot.name, "period_s": setup.mpc.period,
        "iterations": setup.mpc.iterations,
        "settings": {**setup.settings.values, "latency": setup.latency, "friction": _friction(setup)},
        **summary(rows), "episodes": list(rows),
    }  # fmt: skip


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return figures over episodes: counts, medians and worst cases.

    Args:
        rows: figures of the episodes.
    """
    return {
        "seeds": len(rows), "successes": sum(row["success"] for row in rows),
        "stayed_upright": sum(row["stayed_upright"] for row in rows), "falls": sum(row["fell"] for row in rows),
        "followed": sum(row["followed"] is True for row in rows),
        **{name: sum(row[name] for row in rows) for name in ("fallbacks", "relaxed", "damped")},
        "median": {name: over(np.median, rows, name) for name in MEDIANS},
        "worst": {name: over(np.max, rows, name) for name in WORST},
    }  # fmt: skip


def over(figure: Callable[[Any], Any], rows: Sequence[Mapping[str, Any]], name: str) -> float | None:
    """Return a figure over the values of an entry that are known; None if none is.

    Args:
        figure: function of a list.
        rows: the rows.
        name: the entry.
    """
    known = [row[name] for row in rows if row.get(name) is not None]
    return float(figure(known)) if known else None


def _friction(setup: OnlineSetup) -> Any:
    """Return the friction of all seeds, or the range from which it is drawn; None for that of the plant's file."""
    drawn, given = setup.variation.friction, setup.settings
    if drawn is not None:
        return list(drawn)
    return setup.friction if given.fixed_friction is None and given.plant is None else given.fixed_friction


# ---- printed


def print_online(console: Console, setup: OnlineSetup, values: Mapping[str, Any]) -> None:
    """Print a line per seed, median and worst case over seeds, and the number of successes."""
    rows = values["episodes"]
    console.print(
        f"[bold]{setup.title}[/], latency {setup.latency * 1e3:g} ms; {plain(repr(setup.reference))}; "
        f"{plain(_drawn(setup))}",
        soft_wrap=True,
    )
    shown = new_table(
        "seed", ">s", ">speed m/s", ">speed error", ">rms error m/s", ">ms per plan", ">99 %", ">iterations",
        ">us per tick", ">QP iterations", ">relaxed", ">fallbacks", "end",
    )  # fmt: skip
    for row in rows:
        shown.add_row(
            str(row["seed"]), f"{row['end_s']:.2f}", *_cells(row), str(row["relaxed"]), str(row["fallbacks"]), _end(row)
        )
    if len(rows) > 1:
        worst = values["worst"]
        shown.add_section()
        shown.add_row("median", "", *_cells(values["median"]), "", "", "")
        counts = (str(values[name]) for name in ("relaxed", "fallbacks"))
        shown.add_row("worst", "", *_cells({"qp_iterations_mean": None, **worst}), *counts, "")
    console.print(shown)
    for row in rows:
        if row["fell"]:
            console.print(f"[red]seed {row['seed']}: {plain(row['fault'])}[/]", soft_wrap=True)
    good, settings, count = values["successes"] == values["seeds"], setup.settings, values["seeds"]
    judged = sum(row["followed"] is not None for row in rows)
    speed = (
        f"speed within {100 * settings.speed_bound:g} % of the command from {settings.settle:g} s after its changes "
        f"on: {values['followed']} of {judged}"
        if judged
        else f"no episode without a fall is long enough to judge its speed, {settings.settle:g} s after a change of "
        "the command"
    )
    console.print(
        f"[bold {'green' if good else 'red'}]success in {values['successes']} of {count}[/]"
        f" ({settings.seconds:g} s without a fall, and upright at the end: {values['stayed_upright']} of {count}; "
        f"{speed})",
        soft_wrap=True,
    )


def _drawn(setup: OnlineSetup) -> str:
    """Return in words what the seeds draw."""
    given, drawn = setup.settings.values, setup.variation
    friction = _friction(setup)
    parts = [f"masses ±{100 * drawn.mass:g} %"] if drawn.mass else []
    parts += [f"friction {friction[0]:g} to {friction[1]:g}"] if isinstance(friction, list) else []
    parts += [f"first state (× {given['perturbation']:g})"] if given["perturbation"] else []
    parts += [f"noise (× {given['noise']:g})"] if given["noise"] else []
    fixed = "" if isinstance(friction, list) else f"; friction {'of the file' if friction is None else f'{friction:g}'}"
    return f"drawn: {', '.join(parts) or 'nothing'}{fixed}"


def _cells(row: Mapping[str, Any]) -> list[str]:
    error = row.get("speed_error")
    return [
        _cell(row, "speed_m_per_s", 3), "-" if error is None else f"{100 * error:.1f} %",
        _cell(row, "rms_velocity_error_m_per_s", 3), _cell(row, "plan_ms_median", 2), _cell(row, "plan_ms_p99", 2),
        _cell(row, "iterations_mean", 1), _cell(row, "tick_us_median", 0), _cell(row, "qp_iterations_mean", 2),
    ]  # fmt: skip


def _cell(row: Mapping[str, Any], name: str, digits: int) -> str:
    value = row.get(name)
    return "-" if value is None else f"{value:.{digits}f}"


def _end(row: Mapping[str, Any]) -> str:
    if row["fell"]:
        return "[red]fell[/]"
    if not row["upright"]:
        return "[red]not upright[/]"
    return "[yellow]upright, wrong speed[/]" if row["followed"] is False else "[green]upright[/]"
