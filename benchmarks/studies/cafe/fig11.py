"""Fig. 11: iterations of the low level's quadratic program, with and without what the plan knows.

``python benchmarks/studies/cafe/fig11.py --seeds 10`` runs what is missing, and writes fig11.csv, .json and a picture.
It needs ``piaffe[qp]``. The program of every tick is solved by DAQP and by our own method, from no active rows and from
those that are active in the plan at this stage. Iterations are counted as published: changes of the active rows, and
one. The first state is drawn and off the plan, so ticks count from 0.5 s on; a column has those of all ticks.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import daqp
import numpy as np
from matplotlib.figure import Figure
from published import HERE, Cells, Runs, draw, vwbc, write_results

from piaffe import solvers

TAIL, SECONDS, FROM, MOST = 0.5, 3.0, 0.5, 8  # [s], [s], [s]; iterations in the histogram
GAITS = ("bound", "pace")
THEIRS = {"bound": 79.85, "pace": 99.08}
"""Published share of ticks with one iteration, with the plan's guess [%]."""
METHODS = ("daqp, plan's rows", "daqp, no rows", "own, plan's rows", "own, no rows")
_AT_LOWER = 3  # DAQP's sense of a row that is active at its lower bound


def by_daqp(program: Any, first: Any) -> tuple[int, Any]:
    """Return iterations of DAQP (0: no solution) and its active rows.

    Args:
        program: without equality rows.
        first: rows that are active at the start, (k,).
    """
    known = np.isfinite(program.d)
    rows, lower, most = np.ascontiguousarray(program.C[known]), program.d[known], np.full(int(known.sum()), 1e30)
    sense = np.where(first[known], _AT_LOWER, 0).astype(np.int32)
    _, _, flag, info = daqp.solve(program.H, program.g, rows, most, lower, sense, primal_tol=1e-9)
    active = np.zeros(len(known), dtype=bool)
    active[known] = np.abs(np.asarray(info["lam"])) > 0
    return (int(info["iterations"]) if flag == 1 else 0), active


def by_own(program: Any, first: Any) -> int:
    """Return additions and removals of our method, and one; 0: no solution."""
    found = solvers.solve_qp(program.H, program.g, C=program.C, d=program.d, first=first)
    return found.iterations + 1 if found.status is solvers.QpStatus.SOLVED else 0


class Counting:
    """A low level that also solves its program in other ways.

    Args:
        low: the low level, which acts.
    """

    def __init__(self, low: solvers.Vwbc) -> None:
        self.low = low
        self.counts, self.early = ({name: Counter[int]() for name in METHODS} for _ in range(2))
        self._known: dict[tuple[float, int], Any] = {}

    def follow(self, plan: solvers.Plan) -> None:
        """Follow another plan."""
        self.low.follow(plan)
        self._known.clear()

    def control(self, x: Any, t: float) -> Any:
        """Return the control of the low level."""
        program = self.low.program(x, t)
        nothing, guess = np.zeros(len(program.d), dtype=bool), self._of_plan(t, program)
        counts = self.counts if t > FROM - 1e-9 else self.early
        for start, first in (("no rows", nothing), ("plan's rows", guess)):
            counts[f"daqp, {start}"][by_daqp(program, first)[0]] += 1
            counts[f"own, {start}"][by_own(program, first)] += 1
        return self.low.control(x, t)

    def _of_plan(self, t: float, program: Any) -> Any:
        """Return which rows are active where the plan is, at its stage, (k,)."""
        plan: Any = self.low.plan
        where = [part for part in plan.phases if part.times[0] <= t + 1e-9]
        part = where[-1] if where else plan.phases[0]
        k = int(np.clip(np.searchsorted(part.times, t + 1e-9) - 1, 0, len(part.controls) - 1))
        key = (float(part.times[k]), len(program.d))
        if key not in self._known:
            there = self.low.program(plan.world(part.states[k]), float(part.times[k]))
            self._known[key] = (
                there if len(there.d) != len(program.d) else by_daqp(there, np.zeros(len(there.d), bool))[1]
            )
        known = self._known[key]
        return known if isinstance(known, np.ndarray) else np.zeros(len(program.d), dtype=bool)


def of_seed(runs: Runs, seed: int, seconds: float = SECONDS) -> dict[str, Any]:
    """Return the counts of an episode."""
    made: list[Counting] = []

    def low(plan: solvers.Plan) -> Counting:
        made.append(Counting(vwbc(plan)))
        return made[0]

    ended = runs(seed, seconds, low)
    return {"fell": not ended.success, "early": made[0].early, **made[0].counts}


def main(seeds: int, first: int = 0, gaits: tuple[str, ...] = GAITS) -> list[dict[str, Any]]:
    """Run what is missing, and write table and figure of the judged seeds."""
    cells, rows, sums = Cells(HERE / "fig11.work"), [], {}
    for gait in gaits:
        runs = Runs(gait, TAIL)
        told = [cells.get(f"{gait}_seed{seed}", of_seed, runs, seed) for seed in range(first, first + seeds)]
        for name in METHODS:
            count, early = (total([each[name] for each in where]) for where in (told, [each["early"] for each in told]))
            sums[gait, name] = count
            rows.append(summary(gait, name, count, early, sum(each["fell"] for each in told)))
            print(rows[-1], flush=True)
    if first == 0:
        histograms = {f"{gait}, {name}": count for (gait, name), count in sums.items()}
        write_results("fig11", rows, seconds=SECONDS, seeds=seeds, histograms=histograms)
        draw("fig11", figure(sums), (8.0, 3.0))
    return rows


def total(counts: Sequence[Mapping[Any, int]]) -> Counter[int]:
    """Return the sum of counts; JSON has the numbers of iterations as texts."""
    found: Counter[int] = Counter()
    for count in counts:
        found.update({int(number): times for number, times in count.items()})
    return found


def summary(gait: str, name: str, count: Counter[int], early: Counter[int], fell: int) -> dict[str, Any]:
    """Return a row of the table: shares of the ticks [%]."""
    ticks, every = sum(count.values()), count + early
    shares = {most: 100 * sum(count[i] for i in range(1, most + 1)) / ticks for most in (1, 3)}
    all_ticks = 100 * every[1] / sum(every.values())
    method, _, start = name.partition(", ")
    return {
        "gait": gait, "method": method, "start": start, "ticks": ticks, "one_iteration_percent": round(shares[1], 2),
        "at_most_three_percent": round(shares[3], 2), "one_of_all_ticks_percent": round(all_ticks, 2),
        "most": max(count), "without_solution": count[0], "fell": fell,
        "published_one_percent": THEIRS[gait] if start == "plan's rows" else "",
    }  # fmt: skip


def figure(sums: dict[tuple[str, str], Counter[int]]) -> Callable[[Figure], None]:
    """Return what draws the histograms."""

    def fill(on: Figure) -> None:
        axes = on.subplots(1, len(GAITS), sharey=True)
        for ax, gait in zip(axes, GAITS, strict=True):
            for i, name in enumerate(METHODS):
                count = sums[gait, name]
                ticks = sum(count.values())
                heights = [100 * count[k] / ticks for k in range(1, MOST)]
                heights.append(100 * sum(times for k, times in count.items() if k >= MOST) / ticks)
                ax.bar(np.arange(1, MOST + 1) + 0.2 * (i - 1.5), heights, 0.2, label=name)
            ax.set_yscale("log")
            ax.set_title(f"{gait}: share of the ticks [%]")
            ax.set_xlabel(f"iterations ({MOST}: and more)")
        axes[-1].legend()

    return fill


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    main(parser.parse_args().seeds)
