"""Time a tick of the low level on a bound: in C, called from Python, and in NumPy; and following another plan.

``plan_tick.py`` times the plans of a receding horizon.

Mini Cheetah bounds; states are off the plan at random. The time includes the call from Python and the result's copy.
A plan that is followed is the first 25 stages of the bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from common import arguments, surroundings, tell
from qp import bound, states

from piaffe import solvers

TICKS = {"native": 5000, "numpy": 200}
STAGES = 25


@dataclass(frozen=True)
class Shortened:
    """The first phases of a plan."""

    phases: tuple[solvers.PlanPhase, ...]
    row_name: Callable[..., str]


def shortened(plan: solvers.SolvedPlan) -> Shortened:
    """Return the first 25 stages of a plan, as new phases."""
    left, phases = STAGES, []
    for phase in plan.phases:
        n = min(left, len(phase.controls))
        arrays = {name: getattr(phase, name)[:n].copy() for name in (
            "controls", "feedback", "Q_u", "Q_ux", "Q_uu", "p", "g_mask", "h_mask")}  # fmt: skip
        phases.append(
            solvers.PlanPhase(phase.mode, phase.times[: n + 1].copy(), phase.states[: n + 1].copy(), **arrays)
        )
        left -= n
        if left == 0:
            break
    return Shortened(tuple(phases), plan.row_name)


def timed(repeats: int, calls: list[Callable[[], Any]]) -> dict[str, float]:
    """Return median and 99th percentile over calls of the least time of each [µs]."""
    least = np.full(len(calls), np.inf)
    for _ in range(repeats):
        for i, call in enumerate(calls):
            began = perf_counter()
            call()
            least[i] = min(least[i], perf_counter() - began)
    middle, high = np.percentile(1e6 * least, [50, 99])
    return {"median": round(float(middle), 2), "p99": round(float(high), 2)}


def main(repeats: int = 5, json: bool = False, save: bool = False) -> dict[str, Any]:
    """Print and return median and 99th percentile of a tick, and of following a plan [µs]."""
    plan = bound()
    results: dict[str, Any] = {"benchmark": "tick", "ticks": TICKS, "repeats": repeats, "us": {}}
    for backend in ("native", "numpy"):
        controller = solvers.Vwbc(plan, backend=backend)
        told = states(plan, TICKS[controller.backend])
        calls = [lambda x=x, t=t, c=controller: c.control(x, t) for x, t in told]
        results["us"][controller.backend] = timed(repeats, calls)
    measured = solvers.Vwbc(plan, contacts="measured")
    told, rng = states(plan, TICKS[measured.backend]), np.random.default_rng(0)
    flags = [measured.contacts(t) if rng.random() < 0.9 else rng.integers(0, 2, 4) + 0.0 for _, t in told]
    order = np.argsort([t for _, t in told])
    calls = [lambda x=told[i][0], t=told[i][1], f=flags[i]: measured.control(x, t, f) for i in order]
    results["us"]["measured contacts"] = timed(repeats, calls)
    plans = [shortened(plan) for _ in range(20)]
    for name in ("Vwbc", "Riccati"):
        controller = getattr(solvers, name)(plan)
        calls = [lambda each=each, c=controller: c.follow(each) for each in plans * 20]
        results["us"][f"follow, {name}"] = timed(repeats, calls)
    results |= surroundings()
    lines = [f"a tick of Vwbc, and following another plan of {STAGES} stages; µs\n{'':20}{'median':>8}{'99 %':>8}"]
    lines += [f"{name:20}{each['median']:8.1f}{each['p99']:8.1f}" for name, each in results["us"].items()]
    tell(results, lines, json=json, save=save)
    return results


if __name__ == "__main__":
    options = arguments(__doc__ or "", 5).parse_args()
    main(**vars(options))
