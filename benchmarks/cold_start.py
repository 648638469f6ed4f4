"""Time a robot's first solve, with an empty cache and a filled one, and the solves after changes that compile nothing.

Go2 bounds. Every start is a process of its own with a cache of its own; in it the problem then changes gait, weights
and timing, and counters tell what was built: modes lowered by the language and libraries compiled by the backend.
"""

from __future__ import annotations

import json as json_format
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

ROBOT = "go2"
CHANGES = ("the same again", "another gait", "another weight", "another timing", "another start and speed")


def swing(s: Any) -> Any:
    """1 for feet in the air: one function, whichever problem uses it; a new one would be another mode."""
    return 1 - s.feet.contact


def measure() -> dict[str, Any]:
    """Return what one process sees: the first solve, and each later one by what changed."""
    began = perf_counter()
    from piaffe import models, ocp, solvers
    from piaffe.models import base, feet, joints
    from piaffe.solvers.ilqr.native.library import library_for

    imported = perf_counter() - began
    robot = models.load(ROBOT)
    body = models.WholeBody(robot)

    def problem(gait: ocp.Motion, height: float = 50.0, x: float = 0.0) -> ocp.Problem:
        walking = ocp.Objective(
            ocp.track(base.position, weight=(0, 0, height)),
            ocp.track(base.orientation, weight=2.0),
            ocp.track(base.linear_velocity, weight=2.0),
            ocp.track(base.angular_velocity, weight=1.0),
            ocp.track(joints.position, weight=1.0),
            ocp.track(joints.velocity, weight=0.01),
            ocp.track(feet.position, weight=10.0, mask=swing),
            ocp.regularize(joints.torque, weight=0.02),
        )
        limits = ocp.Constraints(
            models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(), models.joint_speed_limits()
        )
        start = body.state(joints="stand", position=(x, 0, robot.base_height("stand")))
        return ocp.Problem(gait.cycles(1), body.until_end(dt=0.01), walking, limits, initial=start)

    def start(declared: ocp.Problem) -> dict[str, Any]:
        """Compile and lay out a problem, then solve it."""
        began = perf_counter()
        compiled = ocp.compile_problem(declared)
        laid_out = perf_counter() - began
        library, built = library_for(compiled)
        solver = solvers.MSiLQR(compiled, solvers.Options(max_iterations=60))
        ready = perf_counter() - began
        counted = {"modes_lowered": compiled.lowered, "libraries_compiled": int(built)}
        solution = solver.solve()
        solved = perf_counter() - began
        return {
            "until_solve_starts_s": ready, "of_these_language_s": laid_out, "until_solved_s": solved,
            "iterations": solution.iterations, "status": solution.status.name,
            "build_s": library.built.seconds if built else 0.0, **counted,
        }  # fmt: skip

    gaits = models.gaits
    began = perf_counter()
    first = {**start(problem(gaits.bound(0.5))), "import_s": imported}
    declared = {
        CHANGES[0]: problem(gaits.bound(0.5)),
        CHANGES[1]: problem(gaits.trot(0.5)),
        CHANGES[2]: problem(gaits.bound(0.5), height=20.0),
        CHANGES[3]: problem(gaits.bound(0.5, stance_time=0.12, flight_time=0.08)),
        CHANGES[4]: problem(gaits.bound(0.8), x=0.3),
    }
    return {"first": first, "next": {name: start(each) for name, each in declared.items()}}


def in_a_process(cache: Path) -> dict[str, Any]:
    """Return what :func:`measure` says in a fresh process with a cache folder."""
    done = subprocess.run(
        [sys.executable, __file__, "--measure"], env={**os.environ, "PIAFFE_CACHE": str(cache)}, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(done.stderr)
    told: dict[str, Any] = json_format.loads(done.stdout)
    return told


def main(repeats: int = 3, json: bool = False, save: bool = False) -> dict[str, Any]:
    """Print and return the medians over several cold and warm starts."""
    from common import surroundings, tell

    cold, warm = [], []
    for _ in range(repeats):
        with tempfile.TemporaryDirectory(prefix="piaffe-") as folder:
            cold.append(in_a_process(Path(folder)))
            warm.append(in_a_process(Path(folder)))
    results: dict[str, Any] = {"benchmark": "cold_start", "robot": ROBOT, "repeats": repeats}
    for name, runs in (("cold cache", cold), ("warm cache", warm)):
        results[name] = {key: _middle([run["first"][key] for run in runs]) for key in runs[0]["first"]}
    results["next solves"] = {
        name: {key: _middle([run["next"][name][key] for run in cold + warm]) for key in cold[0]["next"][name]}
        for name in CHANGES
    }
    for name in CHANGES:
        least = min(run["next"][name]["until_solve_starts_s"] for run in cold + warm)
        results["next solves"][name]["least_until_solve_starts_s"] = round(least, 4)
    results |= surroundings()
    lines = [f"{ROBOT} bound; seconds", f"{'':24}{'ready':>8}{'solved':>8}{'lowered':>9}{'compiled':>9}"]
    rows = {name: results[name] for name in ("cold cache", "warm cache")} | results["next solves"]
    for name, row in rows.items():
        lines.append(
            f"{name:24}{row['until_solve_starts_s']:8.3f}{row['until_solved_s']:8.3f}{row['modes_lowered']:9}"
            f"{row['libraries_compiled']:9}"
        )
    tell(results, lines, json=json, save=save)
    return results


def _middle(values: list[Any]) -> Any:
    """Return the median of seconds, the largest of counters, and all of different texts."""
    if isinstance(values[0], str):
        return " / ".join(dict.fromkeys(values))
    return max(values) if isinstance(values[0], int) else round(median(values), 4)


if __name__ == "__main__":
    if sys.argv[1:] == ["--measure"]:
        print(json_format.dumps(measure()))
    else:
        from common import arguments

        main(**vars(arguments(__doc__, repeats=3).parse_args()))
