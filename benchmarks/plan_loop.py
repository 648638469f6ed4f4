"""Memory and time of the plans of a controller over an hour of motion, and of the first plan at a late time.

A trot of Mini Cheetah for the receding horizon, a trot of Solo12 for the sampling controller. Each plan begins at the
declared first state, whatever the time. Memory is the resident memory of the process after a collection of garbage.
The first tenth of the time, in which buffers and caches fill, is the reference. First plans are those of new
controllers, in turns. Sampling draws 8 samples along the hour, and as many as the example for the first plans: to make
the nodes of a late time ready takes 3 ms, which the first nodes of a motion have had when the controller was made.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from statistics import median
from time import thread_time
from typing import Any

import numpy as np
from common import arguments, example, surroundings, tell
from endurance import resident

from piaffe import sampling, solvers

LATE = 1e6  # [s]
PERIOD = 0.02  # [s]
SAMPLES = 8


def receding(samples: int | None = None) -> Callable[[float], Any]:
    """Return what plans a trot of Mini Cheetah at a time."""
    mpc = solvers.RecedingHorizon(example("trot_mpc").problem)
    return lambda t: mpc.plan(mpc.initial, t)


def sampled(samples: int | None = None) -> Callable[[float], Any]:
    """Return what plans a trot of Solo12 at a time, by samples."""
    module = example("trot_mppi")
    controller = sampling.TDCDMPPI(
        module.sampled_problem(), module.options, reward=module.reward, value=None, threads=1,
        samples=samples or module.options.samples,
    )  # fmt: skip
    return lambda t: controller.plan(controller.problem.initial, t)


Maker = Callable[..., Callable[[float], Any]]
KINDS: dict[str, Maker] = {"receding horizon": receding, "sampling": sampled}


def first(make: Maker, repeats: int) -> dict[str, float]:
    """Return the median time of the first plan of new controllers, at 0 and late [ms]."""
    seconds: dict[float, list[float]] = {0.0: [], LATE: []}
    make()(0.0)  # compiled, and in memory
    for _ in range(repeats):
        for t, found in seconds.items():
            plan = make()
            began = thread_time()
            plan(t)
            found.append(thread_time() - began)
    soon, late = (1e3 * median(found) for found in seconds.values())
    return {"first_plan_ms": round(soon, 3), "first_plan_late_ms": round(late, 3), "ratio": round(late / soon, 3)}


def loop(make: Maker, seconds: float, parts: int) -> dict[str, Any]:
    """Return the resident memory at the ends of the parts [MB], and the median time of a plan in each [ms]."""
    plan, memory, times = make(SAMPLES), [], []
    for ticks in np.array_split(np.arange(round(seconds / PERIOD)), parts):
        taken = np.zeros(len(ticks))
        for i, k in enumerate(ticks):
            began = thread_time()
            plan(int(k) * PERIOD)
            taken[i] = thread_time() - began
        gc.collect()
        memory.append(round(resident(), 2))
        times.append(round(1e3 * float(np.median(taken)), 3))
        print(f"{ticks[-1] * PERIOD:.0f} of {seconds:.0f} s: {memory[-1]} MB", file=sys.stderr, flush=True)
    return {"resident_mb": memory, "plan_ms": times, "growth_mb": round(max(memory) - memory[0], 2)}


def main(
    seconds: float = 3600.0, parts: int = 10, repeats: int = 7, json: bool = False, save: bool = False
) -> dict[str, Any]:
    """Print and return growth of memory and times of plans, by kind of controller."""
    rows = {name: {**first(make, repeats), **loop(make, seconds, parts)} for name, make in KINDS.items()}
    results = {"benchmark": "plan_loop", "seconds": seconds, "period_s": PERIOD, "late_s": LATE, "kinds": rows,
               **surroundings()}  # fmt: skip
    lines = [
        f"plans every {1e3 * PERIOD:g} ms of {seconds:g} s; the first plan at 0 and at {LATE:g} s",
        f"{'':18}{'growth MB':>11}{'plan ms':>9}{'at the end':>12}{'first ms':>10}{'late ms':>9}{'ratio':>7}",
    ]
    for name, row in rows.items():
        lines.append(
            f"{name:18}{row['growth_mb']:11.2f}{row['plan_ms'][0]:9.2f}{row['plan_ms'][-1]:12.2f}"
            f"{row['first_plan_ms']:10.2f}{row['first_plan_late_ms']:9.2f}{row['ratio']:7.2f}"
        )
    tell(results, lines, json=json, save=save)
    return results


if __name__ == "__main__":
    parser = arguments(__doc__ or "", 7)
    parser.add_argument("seconds", type=float, nargs="?", default=3600.0, help="time of the motion")
    parser.add_argument("--parts", type=int, default=10, help="of the time, each with its figures")
    main(**vars(parser.parse_args()))
