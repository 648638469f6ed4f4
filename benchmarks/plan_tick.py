"""Time a plan of a receding horizon: Mini Cheetah trots, 25 whole-body and 10 rigid-body nodes, four iterations.

A plan is called from Python, and its state is that of the last plan with noise. The time is that of the thread, from
measured state to the low level that follows the plan.
"""

from __future__ import annotations

from time import thread_time
from typing import Any

import numpy as np
from cascade import HEAD, HEAD_DT, SPEED, declaration
from common import arguments, compile_for_avx2, surroundings, tell

from piaffe import models, ocp, solvers

TICKS = 400


def problem() -> ocp.Problem:
    """Return a trot with the cascade of models and the terms of ``cascade.py``."""
    body, srb, walking, effort, limits = declaration()
    schedule = body.over(HEAD, dt=HEAD_DT).without(effort) + srb.over(0.50, dt=0.05).without(limits)
    initial = body.state(joints="stand")
    return ocp.Problem(models.gaits.trot(speed=SPEED), schedule, walking + effort, limits, initial=initial)


def main(
    repeats: int = 3, json: bool = False, save: bool = False, avx2: bool = False, adapting: bool = False
) -> dict[str, Any]:
    """Print and return median and 99th percentile of a plan and of its parts [ms]."""
    if avx2:
        compile_for_avx2()
    mpc = solvers.RecedingHorizon(problem(), barrier=solvers.Adapting() if adapting else None)
    assert mpc._native is not None  # there is a compiler
    width = mpc._native.memory.width
    times: list[float] = []
    parts: dict[str, list[float]] = {"numbers": [], "solve": [], "policy": [], "follow": []}
    for seed in range(repeats):
        rng = np.random.default_rng(seed)
        mpc.reset()
        plan = mpc.plan(mpc.initial, 0.0)
        low = solvers.Vwbc(plan)
        for k in range(1, TICKS):
            t = 0.02 * k
            phase = [each for each in plan.parts if each.times[0] <= t + 1e-9][-1]
            node = round((t - phase.times[0]) / mpc.horizon.dt)
            noise = 1e-3 * rng.standard_normal(phase.mode.state.ndx)
            x = plan.world(phase.mode.state.np_plus(phase.states[node], noise))
            began = thread_time()
            plan = mpc.plan(x, t)
            planned = thread_time()
            low.follow(plan)
            times.append(thread_time() - began)
            parts["follow"].append(times[-1] - (planned - began))
            for name, seconds in plan.seconds.items():
                parts[name].append(seconds)
    results: dict[str, Any] = {"benchmark": "plan_tick", "ticks": TICKS, "repeats": repeats, "width": width, "ms": {}}
    for name, values in {"plan": times, **parts}.items():
        middle, high = np.percentile(1e3 * np.array(values), [50, 99])
        results["ms"][name] = {"median": round(float(middle), 3), "p99": round(float(high), 3)}
    results |= surroundings()
    lines = [f"a plan of the receding horizon, vectors of {width}; ms of the thread\n{'':8}{'median':>8}{'99 %':>8}"]
    lines += [f"{name:8}{each['median']:8.2f}{each['p99']:8.2f}" for name, each in results["ms"].items()]
    tell(results, lines, json=json, save=save)
    return results


if __name__ == "__main__":
    parser = arguments(__doc__ or "", 3)
    parser.add_argument("--avx2", action="store_true", help="compile for processors with AVX2, with vectors of four")
    parser.add_argument("--adapting", action="store_true", help="with a barrier that adapts between plans")
    main(**vars(parser.parse_args()))
