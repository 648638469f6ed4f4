"""Table II and Fig. 7: time of an iteration and trials of the line search, over the length of the tail.

``python benchmarks/studies/cafe/table2.py`` measures again (about two minutes on an idle machine), and writes
table2.csv, .json and the picture of Fig. 7; with ``--keep`` it goes on with a run that was stopped. Each receding
horizon runs the closed loop for 2 s. Its plans are then made once more from the same states, in turns with those of the
other horizons, and the thread's processor time is read.
"""

from __future__ import annotations

import argparse
import ctypes as ct
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import mean, median
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from published import HERE, TAIL_DTS, TAILS, Cells, draw, episode, planner, problem, vwbc, write_results

from piaffe import solvers
from piaffe.solvers.constants import STEPS_BACK
from piaffe.solvers.ilqr.native.structs import RecordStruct

TABLE = ("pace", "flying trot", "pronk", "bound")
SECONDS, TURNS, SEED = 2.0, 5, 0  # of the closed loop [s]; of the measurement; of the plant
THEIRS = {
    "pace": (5.4143, 4.8653, 5.0176, 4.9466, 4.8907), "flying trot": (5.2323, 5.1333, 5.0770, 5.1805, 5.0575),
    "pronk": (5.2313, 5.1079, 5.0574, 5.1948, 5.1342),
}  # fmt: skip
"""Published, S0 to S4 [ms]."""


@dataclass
class Recorder:
    """A planner that keeps the states from which plans are made."""

    mpc: solvers.RecedingHorizon
    asked: list[tuple[Any, float]] = field(default_factory=list)

    @property
    def period(self) -> float:
        """Time between plans [s]."""
        return self.mpc.period

    @property
    def initial(self) -> Any:
        """The initial state."""
        return self.mpc.initial

    def reset(self) -> None:
        """Begin anew."""
        self.mpc.reset()
        self.asked.clear()

    def plan(self, x: Any, t: float) -> solvers.Plan:
        """Return the planner's plan."""
        self.asked.append((np.array(x), t))
        return self.mpc.plan(x, t)


def trials_of(steps: list[float], options: solvers.Options) -> int:
    """Return the trials of line searches with these steps, without second-order corrections; 0 is a failed search."""
    count, last = 0, 1.0
    for step in steps:
        size = min(1.0, last / options.step_shrink**STEPS_BACK) if last > 0 else 1.0
        while size >= options.min_step:
            count += 1
            if size <= step * (1 + 1e-9):
                break
            size *= options.step_shrink
        last = step
    return count


class Watch:
    """What a solve in C tells: the steps of its iterations, and its time on the thread's clock.

    Args:
        mpc: a compiled receding horizon.
    """

    def __init__(self, mpc: solvers.RecedingHorizon) -> None:
        tick = mpc.compiled
        assert tick is not None  # there is a compiler
        self._of = tick.memory.problem
        self.history = (RecordStruct * mpc.first_iterations)()
        self._clock = ct.CFUNCTYPE(ct.c_double, ct.c_void_p)(lambda _: time.thread_time())
        self._of.history = ct.cast(self.history, type(self._of.history))
        self._of.clock = ct.cast(self._clock, ct.c_void_p)

    @property
    def steps(self) -> list[float]:
        """Steps of the last solve."""
        return [self.history[j].step_size for j in range(self._of.num_records)]


def replay(mpc: solvers.RecedingHorizon, watch: Watch, asked: list[tuple[Any, float]]) -> dict[str, float]:
    """Make the plans of these states once more; return times of an iteration [ms], and means over the plans."""
    mpc.reset()
    solve, whole, iterations, trials = [], [], [], []
    for i, (x, t) in enumerate(asked):
        began = time.thread_time()
        plan = mpc.plan(x, t)
        took = time.thread_time() - began
        if i:  # the first is solved until no step helps
            solve.append(1e3 * plan.seconds["solve"])
            whole.append(1e3 * took)
            iterations.append(plan.iterations)
            trials.append(trials_of(watch.steps, mpc.options))
    return {
        "iteration_ms": sum(solve) / sum(iterations), "plan_ms": median(whole), "iterations": mean(iterations),
        "trials": mean(trials),
    }  # fmt: skip


def measure(gait: str, dt: float, tails: tuple[float, ...] = TAILS, seconds: float = SECONDS) -> list[dict[str, Any]]:
    """Return rows of a gait and a time step of the rigid body: medians over the turns."""
    made = []
    for tail in tails:
        recorder = Recorder(planner(problem(gait, tail, dt)))
        low = vwbc(recorder.mpc.plan(recorder.initial, 0.0))
        episode(recorder, low, SEED, seconds)
        made.append((recorder, Watch(recorder.mpc)))
    turns: list[list[dict[str, float]]] = [[] for _ in tails]
    for _ in range(TURNS):
        for found, (recorder, watch) in zip(turns, made, strict=True):
            found.append(replay(recorder.mpc, watch, recorder.asked))
    rows = []
    for tail, found, (recorder, _) in zip(tails, turns, made, strict=True):
        row = {"gait": gait, "schedule": f"S{round(10 * tail)}", "dt_s_ms": round(1e3 * dt)}
        row |= {name: round(median(each[name] for each in found), 4) for name in found[0]}
        published = THEIRS.get(gait, ())
        at = tails.index(tail)
        row["published_ms"] = published[at] if dt == TAIL_DTS[0] and at < len(published) else ""
        rows.append(row | {"plans": len(recorder.asked) - 1})
    if 0.5 in tails and 2.0 in tails:
        five, twenty = (turns[tails.index(tail)] for tail in (0.5, 2.0))
        ratio = median(b["iteration_ms"] / a["iteration_ms"] for a, b in zip(five, twenty, strict=True))
        rows[-1]["ratio"] = round(ratio, 3)
    return rows


def figure(rows: list[dict[str, Any]]) -> Callable[[Figure], None]:
    """Return what draws the figure of the bound."""

    def fill(on: Figure) -> None:
        axes = on.subplots(1, 2)
        for ax, name in zip(axes, ("iteration_ms", "trials"), strict=True):
            for dt in (50, 10):
                own = [row for row in rows if row["gait"] == "bound" and row["dt_s_ms"] == dt]
                ax.plot(
                    [int(row["schedule"][1:]) / 10 for row in own], [row[name] for row in own], "o-", label=f"{dt} ms"
                )
            ax.set_xlabel("T_s [s]")
            ax.set_ylim(bottom=0)
        axes[0].set_title("time of an iteration [ms]")
        axes[1].set_title("trials of the line search in a plan")
        axes[0].legend()

    return fill


def main(keep: bool = False) -> list[dict[str, Any]]:
    """Measure what is missing, and write table and figure."""
    folder = HERE / "table2.work"
    if not keep:
        shutil.rmtree(folder, ignore_errors=True)
    cells, rows, ratios = Cells(folder), [], {}
    for gait, dt in [(gait, TAIL_DTS[0]) for gait in TABLE] + [("bound", TAIL_DTS[1])]:
        own = cells.get(f"{gait}_{dt:g}", measure, gait, dt)
        ratios[f"{gait}, {1e3 * dt:g} ms"] = own[-1].pop("ratio")
        rows += own
        print(own[0], ratios, flush=True)
    write_results("table2", rows, **{"S20 / S5": ratios, "turns": TURNS, "seconds": SECONDS})
    draw("fig7", figure(rows), (8.0, 3.0))
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", action="store_true", help="keep what a run that was stopped has measured")
    main(**vars(parser.parse_args()))
