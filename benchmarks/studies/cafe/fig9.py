"""Figs. 9 and 10: a bound is pushed by 1.5 m/s within 50 ms; the solver's feedback against VWBC.

``python benchmarks/studies/cafe/fig9.py --seeds 10`` runs what is missing, and writes fig9.csv, .json, a picture
and two film strips. The feedback is not kept within the limits of torque, as published;
the motors of the plant limit it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from published import HERE, LEAVE_OUT, PICTURES, Cells, Runs, declaration, draw, gains, plant, vwbc, write_results

from piaffe import solvers
from piaffe.simulation import OnlineEpisode, Push
from piaffe.viz import film_online, gl

TAIL, PUSH, SECONDS = 0.5, 2.7, 5.5  # [s]
SPEED, AXES = 1.5, {"y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0)}  # [m/s]
CYCLE, CALM = 0.4, 0.1  # [s]; mean speed to the left over a cycle of a bound that has recovered [m/s]
FILM = (-0.1, 0.8)  # around the push [s]
LOWS = ("VWBC", "Riccati")


class FreeRiccati(solvers.Riccati):
    """The solver's feedback, which is not kept within the limits of torque."""

    def bounded(self, at: Any, x: Any, u: Any) -> Any:
        """Return the control as it is."""
        return u


def low_level(name: str, plan: solvers.Plan) -> Any:
    """Return a low level with the published gains on joints."""
    if name == "VWBC":
        return vwbc(plan)
    return FreeRiccati(plan, gains=gains(), leave_out=LEAVE_OUT, backend="numpy")


def of_episode(run: OnlineEpisode) -> dict[str, float]:
    """Return what an episode shows from the push on."""
    after = run.times >= PUSH
    step = float(np.median(np.diff(run.times)))
    limit = declaration()["robot"].torque_limit
    excess = np.maximum(np.abs(run.controls[after]) - limit, 0.0)
    slip = np.sum(run.slips[after] * run.touching[after] * step, axis=0)
    left, width = run.velocity[:, 1], round(CYCLE / step)
    mean = np.convolve(left, np.ones(width) / width, mode="valid")  # from a tick on
    wild = np.flatnonzero(np.abs(mean) > CALM)
    recovery = float(run.times[wild[-1] + width - 1] - PUSH) if len(wild) else 0.0
    return {
        "fell": float(not run.success), "end": run.end, "excess": float(excess.max(initial=0.0)),
        "over_limit": float(np.mean(np.any(excess > 0, axis=1))) if after.any() else 0.0,
        "slip": float(slip.max(initial=0.0)), "recovery": recovery, "relaxed": run.relaxed,
    }  # fmt: skip


def run_of(runs: Runs, name: str, axis: str, seed: int, seconds: float = SECONDS) -> OnlineEpisode:
    """Return the episode of a low level, a direction and a seed."""
    x, y, z = (SPEED * each for each in AXES[axis])
    return runs(seed, seconds, partial(low_level, name), [Push(time=PUSH, velocity=(x, y, z))])


def of_push(runs: Runs, name: str, axis: str, seed: int) -> dict[str, float]:
    """Return what the episode of a push shows."""
    return of_episode(run_of(runs, name, axis, seed))


def summary(name: str, told: list[dict[str, float]]) -> dict[str, Any]:
    """Return a row of the table: counts, and medians over the episodes; recovery of those that did not fall."""
    upright = [each["recovery"] for each in told if not each["fell"]]
    middle = {name: float(np.median([each[name] for each in told])) for name in told[0]}
    return {
        "low_level": name, "pushes": len(told), "fell": int(sum(each["fell"] for each in told)),
        "largest_torque_beyond_limit_Nm": round(max(each["excess"] for each in told), 2),
        "ticks_beyond_limit": round(float(np.mean([each["over_limit"] for each in told])), 4),
        "slip_m": round(middle["slip"], 3),
        "recovery_s": round(float(np.median(upright)), 2) if upright else "",
    }  # fmt: skip


def figure(runs: dict[str, OnlineEpisode]) -> Callable[[Figure], None]:
    """Return what draws torques that are asked for, and foot slip, around the push."""

    def fill(on: Figure) -> None:
        axes = on.subplots(2, len(runs), sharex=True, sharey="row")
        for column, (name, run) in zip(axes.T, runs.items(), strict=True):
            shown = (run.times >= PUSH - 0.2) & (run.times <= PUSH + 1.0)
            times, limit = run.times[shown] - PUSH, run.robot.torque_limit
            for joint in range(run.robot.num_joints):
                column[0].plot(times, run.controls[shown, joint] / limit[joint], lw=0.5)
            for side in (-1, 1):
                column[0].axhline(side, ls="--", lw=0.8, color="#B3261E")
            for foot, label in enumerate(run.robot.foot_names):
                column[1].plot(times, (run.slips * run.touching)[shown, foot], lw=0.7, label=label)
            column[0].set_title(f"{name}: torques asked for, by their limit")
            column[1].set_title("slip of standing feet [m/s]")
            column[1].set_xlabel("time after the push [s]")
        axes[0, 0].set_ylim(-3, 3)
        axes[1, 0].set_ylim(0, 2.5)
        axes[1, -1].legend()

    return fill


def strip(path: Path, run: OnlineEpisode, seed: int) -> None:
    """Draw six moments around the push."""
    shown = (run.times >= PUSH + FILM[0]) & (run.times <= PUSH + FILM[1])
    names = ("times", "states", "forces")
    film_online(path, replace(run, **{name: getattr(run, name)[shown] for name in names}), plant(seed), size=(900, 420))


def main(seeds: int, first: int = 0) -> list[dict[str, Any]]:
    """Run what is missing, and write table, figure and film strips of the judged seeds."""
    if first == 0:
        gl.prepare()  # before MuJoCo is imported
    cells, runs = Cells(HERE / "fig9.work"), Runs("bound", TAIL)
    every, told = [(axis, seed) for seed in range(first, first + seeds) for axis in AXES], {}
    for name in LOWS:
        told[name] = [cells.get(f"{name}_{axis}_seed{seed}", of_push, runs, name, axis, seed) for axis, seed in every]
        print(summary(name, told[name]), flush=True)
    rows = [summary(name, of) for name, of in told.items()]
    if first == 0:
        falls = [i for i in range(len(every)) if told["Riccati"][i]["fell"] and not told["VWBC"][i]["fell"]]
        axis, seed = every[falls[0] if falls else 0]
        shown = {name: run_of(runs, name, axis, seed) for name in LOWS}
        write_results("fig9", rows, shown={"push along": axis, "seed": seed}, push_s=PUSH, seconds=SECONDS)
        draw("fig9", figure(shown), (9.0, 4.2))
        for name, run in shown.items():
            strip(PICTURES / f"cafe_fig10_{name.lower()}.png", run, seed)
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    main(parser.parse_args().seeds)
