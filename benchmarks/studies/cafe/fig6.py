"""Fig. 6: pitch and pitch rate of a bound over the length of the rigid body's part of the horizon.

``python benchmarks/studies/cafe/fig6.py --seeds 10`` runs what is missing, and writes fig6.csv, .json and a picture.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from published import HERE, TAIL_DTS, TAILS, Cells, Runs, draw, write_results

from piaffe.models import base
from piaffe.ocp import rotation
from piaffe.simulation import OnlineEpisode

SECONDS, FROM = 5.0, 2.0  # of an episode, and from when on it counts [s]


def of_episode(run: OnlineEpisode) -> dict[str, float]:
    """Return root mean squares of pitch [rad] and pitch rate [rad/s] up to a fall, and means of speed and height."""
    told = {"end": run.end, "fell": float(not run.success)}
    counts = run.times >= min(FROM, 0.5 * run.end)
    where, states = run.space.slices, run.states[counts]
    pitch = np.arcsin(np.clip(-rotation.np_matrix(states[:, where[base.orientation]])[:, 2, 0], -1, 1))
    rate = states[:, where[base.angular_velocity]][:, 1]
    return told | {
        "pitch": float(np.sqrt(np.mean(pitch**2))), "rate": float(np.sqrt(np.mean(rate**2))),
        "mean_pitch": float(np.mean(pitch)), "speed": float(np.mean(run.velocity[counts, 0])),
        "height": float(np.mean(states[:, where[base.position]][:, 2])),
    }  # fmt: skip


def of_seed(runs: Runs, seed: int, seconds: float) -> dict[str, float]:
    """Return the figures of a seed's episode."""
    return of_episode(runs(seed, seconds))


def summary(tail: float, dt: float, told: list[dict[str, float]]) -> dict[str, Any]:
    """Return a row of the table: means over seeds."""
    mean = {name: float(np.mean([each[name] for each in told])) for name in told[0]}
    return {
        "schedule": f"S{round(10 * tail)}", "dt_s_ms": round(1e3 * dt), "seeds": len(told),
        "fell": int(sum(each["fell"] for each in told)), "rms_pitch_rad": round(mean["pitch"], 4),
        "rms_pitch_rate_rad_per_s": round(mean["rate"], 3), "mean_pitch_rad": round(mean["mean_pitch"], 4),
        "speed_m_per_s": round(mean["speed"], 3), "height_m": round(mean["height"], 3),
    }  # fmt: skip


def figure(rows: list[dict[str, Any]]) -> Callable[[Figure], None]:
    """Return what draws the figure of a table."""

    def fill(on: Figure) -> None:
        names = {"rms_pitch_rad": "RMS of the pitch [rad]", "rms_pitch_rate_rad_per_s": "RMS of the pitch rate [rad/s]"}
        axes = on.subplots(1, 2)
        for ax, (name, title) in zip(axes, names.items(), strict=True):
            for dt in TAIL_DTS:
                own = [row for row in rows if row["dt_s_ms"] == round(1e3 * dt) or row["schedule"] == "S0"]
                times = [int(row["schedule"][1:]) / 10 for row in own]
                ax.plot(times, [row[name] for row in own], "o-", ms=3, label=f"dt_s {1e3 * dt:g} ms")
            ax.set_title(title)
            ax.set_xlabel("T_s [s]")
            ax.set_ylim(bottom=0)
        axes[0].legend()

    return fill


def main(
    seeds: int, first: int = 0, tails: tuple[float, ...] = TAILS, seconds: float = SECONDS
) -> list[dict[str, Any]]:
    """Run what is missing, and write table and figure of the judged seeds."""
    cells, rows = Cells(HERE / "fig6.work"), []
    for dt in TAIL_DTS:
        for tail in tails:
            if tail or dt == TAIL_DTS[0]:
                runs = Runs("bound", tail, dt)
                told = [
                    cells.get(f"{tail:g}_{dt:g}_seed{seed}", of_seed, runs, seed, seconds)
                    for seed in range(first, first + seeds)
                ]
                rows.append(summary(tail, dt, told))
                print(rows[-1], flush=True)
    if first == 0:
        write_results("fig6", rows, seconds=seconds, counted_from=FROM)
        draw("fig6", figure(rows), (8.0, 3.0))
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    main(parser.parse_args().seeds)
