"""Fig. 8: speed and height of a trot with tails of 0 to 0.4 s, in simulation; published on hardware.

``python benchmarks/studies/cafe/fig8.py --seeds 10`` runs what is missing, and writes fig8.csv, .json and a picture.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from published import HERE, SPEED, Cells, Runs, draw, write_results

from piaffe.models import base
from piaffe.simulation import OnlineEpisode

TAILS = (0.0, 0.1, 0.2, 0.3, 0.4)  # [s]
SECONDS, FROM, EVERY = 5.0, 2.0, 10  # [s], [s], ticks of a point in the figure


def of_episode(run: OnlineEpisode) -> dict[str, Any]:
    """Return figures of an episode, and its speed and height over time."""
    height = run.states[:, run.space.slices[base.position]][:, 2]
    counts = run.times >= min(FROM, 0.5 * run.end)
    speed = run.velocity[:, 0]
    return {
        "end": run.end, "fell": float(not run.success), "speed": float(np.mean(speed[counts])),
        "speed_error": float(np.sqrt(np.mean((speed[counts] - SPEED) ** 2))),
        "height": float(np.mean(height[counts])), "height_deviation": float(np.std(height[counts])),
        "series": [np.round(each[::EVERY], 4).tolist() for each in (run.times, speed, height)],
    }  # fmt: skip


def of_seed(runs: Runs, seed: int, seconds: float) -> dict[str, Any]:
    """Return the figures of a seed's episode."""
    return of_episode(runs(seed, seconds))


def summary(tail: float, told: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a row of the table: means over seeds, and the earliest fall."""
    mean = {name: float(np.mean([each[name] for each in told])) for name in told[0] if name != "series"}
    fallen = [each["end"] for each in told if each["fell"]]
    return {
        "schedule": f"S{round(10 * tail)}", "seeds": len(told), "fell": len(fallen),
        "first_fall_s": round(min(fallen), 2) if fallen else "", "speed_m_per_s": round(mean["speed"], 3),
        "rms_speed_error_m_per_s": round(mean["speed_error"], 3), "height_m": round(mean["height"], 3),
        "height_deviation_m": round(mean["height_deviation"], 4),
    }  # fmt: skip


def figure(series: dict[str, Any]) -> Callable[[Figure], None]:
    """Return what draws speed and height of the first seed."""

    def fill(on: Figure) -> None:
        axes = on.subplots(1, 2)
        for ax, i, title in zip(axes, (1, 2), ("speed [m/s]", "height of the base [m]"), strict=True):
            for label, values in series.items():
                ax.plot(values[0], values[i], lw=0.8, label=label)
            ax.set_title(title)
            ax.set_xlabel("time [s]")
        axes[0].legend()

    return fill


def main(
    seeds: int, first: int = 0, tails: tuple[float, ...] = TAILS, seconds: float = SECONDS
) -> list[dict[str, Any]]:
    """Run what is missing, and write table and figure of the judged seeds."""
    cells, rows, series = Cells(HERE / "fig8.work"), [], {}
    for tail in tails:
        runs = Runs("trot", tail)
        told = [cells.get(f"{tail:g}_seed{seed}", of_seed, runs, seed, seconds) for seed in range(first, first + seeds)]
        rows.append(summary(tail, told))
        series[rows[-1]["schedule"]] = told[0]["series"]
        print(rows[-1], flush=True)
    if first == 0:
        write_results("fig8", rows, seconds=seconds, counted_from=FROM)
        draw("fig8", figure(series), (8.0, 3.0))
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    main(parser.parse_args().seeds)
