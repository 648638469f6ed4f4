"""Output of ``piaffe mppi``: one JSON object, or tables and a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console

from piaffe.sampling import Trial
from piaffe.simulation import Episode

from .reports import new_table


def episode_values(trial: Trial, episodes: Mapping[int, Episode]) -> dict[str, Any]:
    """Return the values that ``mppi --json`` prints: settings, figures over all seeds, and figures of each seed.

    Args:
        trial: the trial.
        episodes: its episodes by seed.
    """
    controller = trial.controller
    return {
        "controller": trial.settings["controller"], "problem": str(controller.problem.source),
        "model": controller.model.name, "plant": trial.plant.name, "dt_s": controller.dt,
        "settings": {
            **trial.settings, "horizon": controller.steps, "samples": controller.options.samples,
            "temperature": controller.options.temperature, "engine": controller.engine.name,
        },
        **summary([episode.summary() for episode in episodes.values()]),
        "episodes": [{"seed": seed, **episode.summary()} for seed, episode in episodes.items()],
    }  # fmt: skip


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return figures over the summaries of several episodes: counts, means, worst cases."""
    names = list(rows[0]["missed_percent"])
    missed = {name: float(np.mean([row["missed_percent"][name] for row in rows])) for name in names}
    return {
        "seeds": len(rows),
        "successes": sum(row["success"] for row in rows),
        "falls": sum(row["fell"] for row in rows),
        "mean_reward": mean(rows, "mean_reward"),
        "missed_percent": missed,
        "missed_percent_worst": max(missed.values(), default=0.0),
        "speed_error_m_per_s": mean(rows, "speed_error_m_per_s"),
        "speed_error_m_per_s_worst": max(row["speed_error_m_per_s"] for row in rows),
        "plan_ms_median": float(np.median([row["plan_ms_median"] for row in rows])),
        "plan_ms_p95": float(np.median([row["plan_ms_p95"] for row in rows])),
        "effective_samples_median": float(np.median([row["effective_samples_median"] for row in rows])),
        "failed_rollouts": sum(row["failed_rollouts"] for row in rows),
    }


def mean(rows: Sequence[Mapping[str, Any]], key: str) -> float:
    """Return the mean of an entry over rows."""
    return float(np.mean([row[key] for row in rows]))


def print_episodes(console: Console, trial: Trial, values: Mapping[str, Any]) -> None:
    """Print a line per seed, means over seeds, the mean violation of each constraint, and the number of successes."""
    settings, dt, kind = values["settings"], values["dt_s"], type(trial.controller)
    value = "" if not kind.uses_value else ", with a value" if settings["value"] else ", without a value"
    console.print(
        f"[bold]{kind.title}[/], H = {settings['horizon']} ({settings['horizon'] * dt:.2f} s), "
        f"{settings['samples']} samples, λ = {settings['temperature']:g}{value}, "
        f"engine {settings['engine']}; plant '{values['plant']}'",
        soft_wrap=True,
    )
    shown = new_table(
        "seed", ">steps", ">reward", ">violation", ">speed error", ">ms per plan", ">95 %", ">effective samples",
        ">NaN", "end",
    )  # fmt: skip
    for row in values["episodes"]:
        shown.add_row(str(row["seed"]), str(row["steps"]), *_cells(row), _end(row))
    if len(values["episodes"]) > 1:
        shown.add_section()
        shown.add_row("all", "", *_cells(values), "")
    console.print(shown)
    missed = new_table("constraint", ">mean violation")
    for name, percent in values["missed_percent"].items():
        colour = "green" if percent <= 0.1 else "yellow" if percent <= 1 else "red"
        missed.add_row(name, f"[{colour}]{percent:.3f} %[/]")
    if values["missed_percent"]:
        console.print(missed)
    good = values["successes"] == values["seeds"]
    console.print(
        f"[bold {'green' if good else 'red'}]success in {values['successes']} of {values['seeds']}[/]"
        f" ({settings['steps'] * dt:g} s without a fall, and at least 0.8 of the commanded distance)"
    )


def _cells(row: Mapping[str, Any]) -> list[str]:
    worst = max(row["missed_percent"].values(), default=0.0)
    return [
        f"{row['mean_reward']:.4f}", f"{worst:.2f} %", f"{row['speed_error_m_per_s']:.3f} m/s",
        f"{row['plan_ms_median']:.1f}", f"{row['plan_ms_p95']:.1f}", f"{row['effective_samples_median']:.1f}",
        str(row["failed_rollouts"]),
    ]  # fmt: skip


def _end(row: Mapping[str, Any]) -> str:
    if row["fell"]:
        return f"[red]fell after {row['distance_m']:.2f} m[/]"
    share = f"{row['distance_m']:.2f} of {row['commanded_m']:.2f} m"
    return f"[green]{share}[/]" if row["success"] else f"[yellow]{share}[/]"
