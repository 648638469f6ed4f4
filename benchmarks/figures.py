"""Draw benchmarks/results/*.json into docs/assets/, each picture with the machine and the date of its figures."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, ScalarFormatter

from piaffe.viz.style import BOUND, LEGS, NEUTRAL, RC

RESULTS = Path(__file__).with_name("results")
ASSETS = Path(__file__).resolve().parents[1] / "docs" / "assets"
LANES = {1: LEGS[1], 4: LEGS[5], 8: LEGS[0]}
ROBOTS = {"solo12": "Solo12", "go2": "Go2"}


def vs_crocoddyl(results: dict[str, Any]) -> Figure:
    """Return bars of the time per node, with how many times faster the widest lanes are."""
    robots = results["robots"]
    figure, axes = plt.subplots(1, len(robots), figsize=(9.5, 3.8), sharey=True, squeeze=False)
    for ax, (name, result) in zip(axes[0], robots.items(), strict=True):
        times, ratios = result["us_per_node"], result["times_faster"]["W=8"]
        parts = list(times["crocoddyl"])
        looks = {"crocoddyl": ("Crocoddyl", NEUTRAL)}
        looks |= {f"W={w}": (f"Piaffe, {w} lane{'s' if w > 1 else ''}", LANES[w]) for w in (1, 4, 8)}
        for i, (who, (label, colour)) in enumerate(looks.items()):
            values = [times[who][part]["median"] for part in parts]
            ax.bar(np.arange(len(parts)) + 0.2 * (i - 1.5), values, 0.19, color=colour, label=label)
        for x, part in enumerate(parts):
            top = times["crocoddyl"][part]["median"]
            ax.annotate(
                f"{ratios[part]['median']:.1f}×", (x, top), (0, 3), textcoords="offset points", ha="center", size=8
            )
        wrapped = [
            part.replace(" with ", "\nwith ").replace(" of ", "\nof ").replace("whole ", "whole\n") for part in parts
        ]
        ax.set_xticks(range(len(parts)), wrapped, fontsize=7.2)
        ax.set_title(ROBOTS.get(name, name))
        ax.grid(visible=False, axis="x")
    axes[0, 0].set_ylabel("µs per node, median")
    axes[0, 0].legend()
    return figure


def like_for_like(results: dict[str, Any]) -> Figure:
    """Return bars of the parts of an iteration for each processor that both are compiled for: least times, ratios."""
    robots, parts = results["robots"], ("derivatives", "backward", "forward with evaluation")
    shades = {"crocoddyl": ("0.35", "0.55", "0.75"), "piaffe": (LEGS[0], LEGS[5], LEGS[1])}
    figure, axes = plt.subplots(1, len(robots), figsize=(9.5, 3.6), sharey=True, squeeze=False)
    for ax, (name, result) in zip(axes[0], robots.items(), strict=True):
        times, faster = result["us_per_node"], result["times_faster"]
        for x, target in enumerate(results["lanes"]):
            for place, (who, colours) in zip((-0.2, 0.2), shades.items(), strict=True):
                bottom = 0.0
                for part, colour in zip(parts, colours, strict=True):
                    value = times[f"{who} {target}"][part]["least"]
                    label = f"{who.title()}, {part}" if x == 0 else None
                    ax.bar(x + place, value, 0.38, bottom=bottom, color=colour, label=label)
                    bottom += value
            ratio = faster[target]["whole iteration"]["least"]
            ax.annotate(f"{ratio:.1f}×", (x + 0.2, bottom), (0, 3), textcoords="offset points", ha="center", size=9)
        labels = [f"-march={target}\nPiaffe: {lanes} lanes" for target, lanes in results["lanes"].items()]
        ax.set_xticks(range(len(labels)), labels)
        ax.set_title(ROBOTS.get(name, name))
        ax.grid(visible=False, axis="x")
    axes[0, 0].set_ylabel("µs per node and iteration, least")
    axes[0, 0].set_ylim(top=1.3 * axes[0, 0].get_ylim()[1])  # room for the legend
    axes[0, 0].legend(ncols=2)
    return figure


def cascade(results: dict[str, Any]) -> Figure:
    """Return the time of an iteration over the length of the rigid body's stretch."""
    rows = results["schedules"]
    figure, axes = plt.subplots(1, 2, figsize=(9.5, 3.5), sharey=True)
    gaits = list(dict.fromkeys(row["gait"] for row in rows))
    for ax, dt in zip(axes, (0.01, 0.05), strict=True):
        for gait, colour in zip(gaits, LEGS, strict=False):
            own = [row for row in rows if row["gait"] == gait and row["tail_dt"] == dt]
            x = [row["tail"] for row in own]
            ax.plot(x, [row["ms"]["iteration"]["median"] for row in own], "o-", ms=3, color=colour, label=gait)
            ax.plot(x, [row["ms"]["mean in a solve"]["median"] for row in own], "--", lw=0.8, color=colour)
        ax.set_title(f"rigid body steps {1e3 * dt:.0f} ms")
        ax.set_xlabel("length of the rigid body's stretch [s]; 0.25 s of whole body before it")
    axes[1].axhline(0.5, color=BOUND, lw=0.9, ls=":")
    axes[1].annotate("aim for S5", (2.0, 0.5), (0, -9), textcoords="offset points", ha="right", color=BOUND, size=8)
    axes[0].set_ylabel("ms per iteration, median")
    axes[0].set_ylim(bottom=0)
    axes[0].plot([], [], "--", lw=0.8, color=NEUTRAL, label="in a solve, all trials")
    axes[0].legend()
    return figure


def scaling(results: dict[str, Any]) -> Figure:
    """Return the time per node over the number of nodes, for each number of lanes; and what a second thread costs."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.3), width_ratios=(2, 1))
    for lanes, colour in LANES.items():
        own = [row for row in results["sizes"] if row["lanes"] == lanes]
        times = [row["us_per_node"]["iteration"]["median"] for row in own]
        left.plot(
            [row["nodes"] for row in own],
            times,
            "o-",
            ms=3,
            color=colour,
            label=f"{lanes} lanes" if lanes > 1 else "1 lane",
        )
    left.set_xscale("log")
    left.set_xticks([row["nodes"] for row in results["sizes"] if row["lanes"] == 1])
    left.xaxis.set_major_formatter(ScalarFormatter())
    left.xaxis.set_minor_formatter(NullFormatter())
    left.set_ylim(bottom=0)
    left.set_xlabel("nodes")
    left.set_ylabel("µs per node and iteration, median")
    left.legend()
    threads = results["threads"]
    x = np.arange(len(threads))
    right.bar(x - 0.2, [row["gain"] for row in threads], 0.38, color=LEGS[0], label="solved in the same time")
    right.bar(x + 0.2, [row["processor_time"] for row in threads], 0.38, color=LEGS[1], label="processor time of each")
    right.axhline(1.0, color=NEUTRAL, lw=0.7)
    right.axhline(results["gain_of_hashing"], color=BOUND, lw=0.9, ls=":", label="the same of hashing")
    right.set_xticks(x, [str(row["nodes"]) for row in threads])
    right.set_ylim(0, 3.2)
    right.set_xlabel("nodes")
    right.set_title("two solves at once, against one")
    right.grid(visible=False, axis="x")
    right.legend()
    return figure


def cold_start(results: dict[str, Any]) -> Figure:
    """Return bars of the time until a solve starts, and until it ends."""
    rows = {name: results[name] for name in ("cold cache", "warm cache")} | results["next solves"]
    figure, ax = plt.subplots(figsize=(9.5, 3.0))
    y = np.arange(len(rows))[::-1]
    ready, solved = ([row[key] for row in rows.values()] for key in ("until_solve_starts_s", "until_solved_s"))
    ax.barh(y, solved, 0.6, color=LEGS[5], label="until it is solved")
    ax.barh(y, ready, 0.6, color=LEGS[0], label="until the solve starts")
    for at, row, begins, ends in zip(y, rows.values(), ready, solved, strict=True):
        text = f"{begins:.2g} s, {ends:.2g} s; {row['libraries_compiled']} compiled"
        ax.annotate(text, (ends, at), (4, 0), textcoords="offset points", va="center", size=7.5)
    for limit in (20.0, 0.05):
        ax.axvline(limit, color=BOUND, lw=0.9, ls=":")
    ax.set_xscale("log")
    ax.set_xlim(0.01, 250)
    ax.set_yticks(y, list(rows))
    ax.set_xlabel("seconds, median; dotted: 20 s for the first solve, 0.05 s until a later one starts")
    ax.grid(visible=False, axis="y")
    ax.legend(loc="lower right")
    return figure


def main(names: list[str]) -> list[Path]:
    """Draw the results of these names, or every result that there is, and return the pictures."""
    drawn = []
    for draw in (vs_crocoddyl, like_for_like, cascade, scaling, cold_start):
        if names and draw.__name__ not in names:
            continue
        source = RESULTS / f"{draw.__name__}.json"
        if not source.exists():
            continue
        results = json.loads(source.read_text(encoding="utf-8"))
        with mpl.rc_context(RC):
            figure = draw(results)
            machine = f"{results['processor']}, {results['cores']} cores (load {results['load'][0]})"
            where = f"{machine}; {results['date'][:10]}; {results['commit']}"
            figure.tight_layout(rect=(0, 0.04, 1, 1))
            figure.text(0.995, 0.01, where, ha="right", size=6.5, color=NEUTRAL)
            path = ASSETS / f"{source.stem}.png"
            figure.savefig(path, dpi=110, metadata={"Software": None})
            plt.close(figure)
        drawn.append(path)
    print("\n".join(map(str, drawn)))
    return drawn


if __name__ == "__main__":
    main(sys.argv[1:])
