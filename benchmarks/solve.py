"""Time the parts of one iteration of the barrel roll in the NumPy backend, and print medians as JSON.

Every repetition runs all parts in turn, so that a busy machine disturbs them alike; pairs are timed side by side.
"""

import argparse
import json
import os
import platform
import runpy
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np

from piaffe import solvers
from piaffe.solvers.ilqr.iterate import Iterate
from piaffe.solvers.ilqr.riccati import backward, roll_out
from piaffe.solvers.ilqr.run import Run

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
Parts = dict[str, Callable[[], object]]


def parts_of(solver: solvers.MSiLQR) -> Parts:
    """Return what one iteration consists of, at the initial guess, and the same evaluation node by node."""
    run = Run(solver.functions, solver.scaled_options(), solver.start(None), solver.flags(True), None)
    models = run.linearise()
    regularization = 1e-6
    while (sweeps := backward(models, regularization)) is None:
        regularization *= 10
    direction = roll_out(models, sweeps)

    def node_by_node() -> None:
        for i, (x, u) in enumerate(zip(run.current.iterate.states, run.current.iterate.controls, strict=True)):
            for k in range(len(u)):
                solver.functions.step(i, k, x[k], u[k])

    def trial() -> float:
        states = [
            p.mode.state.np_plus(x, 0.1 * dx)
            for p, x, dx in zip(solver.problem.phases, run.current.iterate.states, direction.dx, strict=True)
        ]
        controls = [u + 0.1 * du for u, du in zip(run.current.iterate.controls, direction.du, strict=True)]
        return run.augmented(run.evaluate(Iterate(states, controls)))

    return {
        "evaluation": lambda: run.evaluate(run.current.iterate),
        "derivatives": run.linearise,
        "backward sweep": lambda: backward(models, regularization),
        "linear roll-out": lambda: roll_out(models, sweeps),
        "line search, one trial": trial,
        "dynamics node by node": node_by_node,
    }


def measure(parts: Parts, repeats: int) -> dict[str, float]:
    """Return the median time of every part [ms]."""
    times: dict[str, list[float]] = {name: [] for name in parts}
    for part in parts.values():
        part()  # buffers are made on first use
    for _ in range(repeats):
        for name, part in parts.items():
            began = perf_counter()
            part()
            times[name].append(1e3 * (perf_counter() - began))
    return {name: round(median(values), 3) for name, values in times.items()}


def whole_iterations(solver: solvers.MSiLQR) -> float:
    """Return the median time of one iteration in a solve [ms], all its trials included."""
    stamps = [perf_counter()]
    solver.solve(progress=lambda record: stamps.append(perf_counter()))
    return round(1e3 * median(after - before for before, after in pairwise(stamps)), 3)


def main(example: str = "barrel_roll.py", repeats: int = 15) -> dict[str, float]:
    """Print the medians as JSON and return them [ms]."""
    problem = runpy.run_path(str(EXAMPLES / example))["problem"]
    began = perf_counter()
    solver = solvers.MSiLQR(problem() if callable(problem) else problem, backend="numpy")
    built = perf_counter() - began
    medians = measure(parts_of(solver), repeats)
    stages = solver.problem.num_stages
    in_turn = ("derivatives", "backward sweep", "linear roll-out", "line search, one trial")
    iteration = sum(medians[name] for name in in_turn)
    limited = solvers.MSiLQR(solver.problem, solvers.Options(max_iterations=20), backend="numpy")
    report = {
        "example": example,
        "stages": stages,
        "build_s": round(built, 3),
        "median_ms": medians,
        "iteration_ms": {"sum of its parts": round(iteration, 3), "in a solve of 20": whole_iterations(limited)},
        "iteration_us_per_stage": round(1e3 * iteration / stages, 1),
        "pairs": {
            "evaluation: node by node / all nodes at once": round(
                medians["dynamics node by node"] / medians["evaluation"], 2
            ),
            "derivatives / evaluation": round(medians["derivatives"] / medians["evaluation"], 2),
        },
        "backend": "numpy",
        "repeats": repeats,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
    }
    print(json.dumps(report, indent=2))
    return medians


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("example", nargs="?", default="barrel_roll.py", help="a file in examples/")
    parser.add_argument("--repeats", type=int, default=15)
    main(**vars(parser.parse_args()))
