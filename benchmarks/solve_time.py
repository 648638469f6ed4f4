"""Time the solver on the examples: building functions, and one iteration, per node."""

import runpy
from itertools import pairwise
from pathlib import Path
from time import perf_counter

from rich.console import Console
from rich.table import Table

from piaffe import solvers

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def measure(file: str, name: str = "problem", iterations: int = 10) -> tuple[int, float, float]:
    """Return an example's stages, the time to build its solver [s] and that of one iteration, the fastest [s]."""
    declared = runpy.run_path(str(EXAMPLES / file))[name]
    problem = declared() if callable(declared) else declared
    began = perf_counter()
    solver = solvers.MSiLQR(problem, solvers.Options(max_iterations=iterations))
    built = perf_counter() - began
    stamps: list[float] = [perf_counter()]
    solver.solve(progress=lambda record: stamps.append(perf_counter()))
    fastest = min(after - before for before, after in pairwise(stamps))
    return sum(phase.num_stages for phase in solver.problem.phases), built, fastest


def main(iterations: int = 10) -> dict[str, float]:
    """Print a table and return the time of one iteration per example [s]."""
    table = Table("example", "stages", "build [s]", "iteration [ms]", "per stage [µs]")
    times = {}
    for file in ("barrel_roll.py", "cascade.py"):
        stages, built, iteration = measure(file, iterations=iterations)
        table.add_row(file, str(stages), f"{built:.2f}", f"{1e3 * iteration:.1f}", f"{1e6 * iteration / stages:.0f}")
        times[file] = iteration
    Console().print(table)
    return times


if __name__ == "__main__":
    main()
