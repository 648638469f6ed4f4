"""Time the quadratic programs of the low level: the method of Piaffe, DAQP and OSQP, each from a cold start.

Mini Cheetah bounds. The programs are those of states that are off the plan at random, a third of them far off.
Times are those of the C code, with the factorisation of the Hessian; for DAQP and OSQP what they say themselves, set-up
and its allocations included.
"""

from __future__ import annotations

import ctypes as ct
from importlib.resources import files
from importlib.util import find_spec
from typing import Any

import numpy as np
from common import arguments, surroundings, tell

from piaffe import models, ocp, solvers
from piaffe.codegen import SOLVER_FLAGS, build, load, pointer
from piaffe.models import base, feet, joints
from piaffe.solvers.qp import QpStatus, qp_method
from piaffe.solvers.tracking import stage_at

COUNT, TURNS = 210, 50
_TIMED = """
#include <time.h>
static double now(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return t.tv_sec + 1e-9 * t.tv_nsec; }
int timed(int turns, int n, int m, int k, const double *H, const double *g, const double *A, const double *b,
          const double *C, const double *d, double *x, double *multipliers, int *active, int *counts, double *work,
          int *places, double *seconds)
{
    int status = 0;
    for (int turn = 0; turn < turns; turn++) {
        for (int i = 0; i < k; i++) active[i] = 0;
        double began = now();
        status = piaffe_qp(n, m, k, H, g, A, b, C, d, x, multipliers, active, counts, work, places);
        double took = now() - began;
        if (turn == 0 || took < *seconds) *seconds = took;
    }
    return status;
}
"""


def swing(s: Any) -> Any:
    """1 for feet in the air."""
    return 1 - s.feet.contact


def bound() -> solvers.SolvedPlan:
    """Return the plan of a bound."""
    body = models.WholeBody(models.load("mini_cheetah"))
    walking = ocp.Objective(
        ocp.track(base.position, weight=(0, 0, 50)), ocp.track(base.orientation, weight=2.0),
        ocp.track(base.linear_velocity, weight=2.0), ocp.track(base.angular_velocity, weight=1.0),
        ocp.track(joints.position, weight=1.0), ocp.track(joints.velocity, weight=0.01),
        ocp.track(feet.position, weight=10.0, mask=swing), ocp.regularize(joints.torque, weight=0.02),
    )  # fmt: skip
    limits = ocp.Constraints(models.friction_cone(mu=0.6), models.torque_limits())
    gait = models.gaits.bound(0.5).cycles(2)
    problem = ocp.Problem(gait, body.until_end(dt=0.01), walking, limits, initial=body.state(joints="stand"))
    compiled = ocp.compile_problem(problem)
    return solvers.SolvedPlan(solvers.MSiLQR(compiled).solve().raise_if_failed(), compiled)


def states(plan: solvers.SolvedPlan, count: int) -> list[tuple[np.ndarray, float]]:
    """Return states that are off a plan at random, a third of them far off, and their times [s]."""
    rng, end = np.random.default_rng(0), float(plan.phases[-1].times[-1])
    deviation, found = np.repeat([0.01, 0.04, 0.03, 0.3, 0.6, 0.8], [3, 3, 12, 3, 3, 12]), []
    for i in range(count):
        t = rng.uniform(0.0, end)
        at = stage_at(plan, t)
        off = (0.1, 0.3, 1.0)[i % 3] * deviation * rng.standard_normal(36)
        found.append((at.mode.state.np_plus(at.x, off), t))
    return found


def programs() -> list[tuple[np.ndarray, ...]]:
    """Return H, g, A, b, C, d of programs of the bound."""
    plan = bound()
    controller = solvers.Vwbc(plan)
    return [controller.program(x, t)[:6] for x, t in states(plan, COUNT)]


def own(library: ct.CDLL, program: tuple[np.ndarray, ...]) -> tuple[int, float, int]:
    """Return status, seconds in C and iterations of the own method."""
    H, g, A, b, C, d = (np.ascontiguousarray(part) for part in program)
    n, m, k = len(g), len(b), len(d)
    x, multipliers, work, seconds = np.zeros(n), np.zeros(m + k), np.zeros(n * (2 * n + 5) + 3 * (m + k)), np.zeros(1)
    active, counts, places = (np.zeros(size, dtype=np.int32) for size in (k, 2, n + m + 2 * k))
    arrays = (H, g, A, b, C, d, x, multipliers, active, counts, work, places, seconds)
    return library.timed(TURNS, n, m, k, *map(pointer, arrays)), float(seconds[0]), int(counts[0])


def others(name: str, program: tuple[np.ndarray, ...]) -> tuple[bool, float]:
    """Return whether DAQP or OSQP solved a program, and the seconds that it says."""
    import daqp
    import osqp
    from scipy import sparse

    H, g, A, b, C, d = program
    rows = np.ascontiguousarray(np.vstack([A, C]))
    lower, upper = np.concatenate([b, d]), np.concatenate([b, np.full(len(d), 1e30)])
    if name == "daqp":
        _, _, flag, info = daqp.solve(H, g, rows, upper, lower, np.zeros(len(lower), dtype=np.int32))
        return flag == 1, info["setup_time"] + info["solve_time"]
    solver = osqp.OSQP()
    solver.setup(sparse.csc_matrix(np.triu(H)), g, sparse.csc_matrix(rows), lower, upper, verbose=False)
    info = solver.solve(raise_error=False).info
    return info.status == "solved", info.setup_time + info.solve_time


def main(repeats: int = 5, json: bool = False, save: bool = False) -> dict[str, Any]:
    """Print and return median and 99th percentile of each method [µs], and how many programs it solved."""
    every = programs()
    source = files("piaffe.solvers.qp").joinpath("template", "dual.c").read_text(encoding="utf-8") + _TIMED
    library = load(build([("timed", source)], flags=SOLVER_FLAGS, label="benchmark of quadratic programs"))
    solved = QpStatus.SOLVED
    runs = [own(library, program) for program in every]
    iterations = np.array([run[2] for run in runs])
    results: dict[str, Any] = {"benchmark": "qp", "programs": COUNT, "variables": 12}
    results["rows"] = [int(min(len(p[5]) for p in every)), int(max(len(p[5]) for p in every))]
    results["own"] = _figures([run[1] for run in runs], sum(list(QpStatus)[run[0]] is solved for run in runs))
    results["own"] |= {
        "without an iteration": float(np.mean(iterations == 0)),
        "most iterations": int(iterations.max()),
    }
    for name in ("daqp", "osqp"):
        if find_spec(name):
            told = [[others(name, program) for program in every] for _ in range(repeats)]
            results[name] = _figures(
                np.min([[t for _, t in turn] for turn in told], axis=0), sum(ok for ok, _ in told[0])
            )
    if "daqp" in results:
        method, other = qp_method("own"), qp_method("daqp")
        pairs = [(method(*p, None), other(*p, None)) for p in every]
        off = [np.abs(a.x - b.x).max() for a, b in pairs if a.status is solved and b.status is solved]
        results["largest difference from daqp [Nm]"] = float(max(off))
    results |= surroundings()
    lines = [f"{COUNT} programs of 12 variables and {results['rows'][0]} to {results['rows'][1]} rows; µs"]
    lines += [f"{name:6}{results[name]}" for name in ("own", "daqp", "osqp") if name in results]
    tell(results, lines, json=json, save=save)
    return results


def _figures(seconds: Any, count: int) -> dict[str, Any]:
    """Return median and 99th percentile [µs], and the number of programs that were solved."""
    middle, high = np.percentile(1e6 * np.asarray(seconds), [50, 99])
    return {"median_us": round(float(middle), 2), "p99_us": round(float(high), 2), "solved": int(count)}


if __name__ == "__main__":
    options = arguments(__doc__ or "", 5).parse_args()
    main(**vars(options))
