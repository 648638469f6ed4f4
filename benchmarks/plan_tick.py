"""Time a plan of a receding horizon: Mini Cheetah trots, 25 whole-body and 10 rigid-body nodes, four iterations.

A plan is called from Python, and its state is that of the last plan with noise. The time is that of the thread, from
measured state to the low level that follows the plan.
"""

from __future__ import annotations

from time import thread_time
from typing import Any

import numpy as np
from common import arguments, surroundings, tell

from piaffe import models, ocp, solvers
from piaffe.models import base, feet, joints

TICKS = 400


def problem() -> ocp.Problem:
    """Return the trot with a cascade of models."""
    robot = models.load("mini_cheetah")
    body, srb = models.WholeBody(robot), models.SingleRigidBody(robot)
    objective = ocp.Objective(
        ocp.track(base.position, weight=(0, 0, 50)),
        ocp.track(base.orientation, weight=(2, 2, 1)),
        ocp.track(base.linear_velocity, weight=2.0),
        ocp.track(base.angular_velocity, weight=(2, 2, 1)),
        ocp.track(joints.position, weight=1.0),
        ocp.track(joints.velocity, weight=0.01),
        ocp.track(feet.position, weight=10.0, mask=lambda s: 1 - s.feet.contact),
        ocp.regularize(joints.torque, weight=0.02),
        models.soft_landing(weight=1.0),
    )
    limits = ocp.Constraints(
        models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(), models.joint_speed_limits(),
        models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0),
    )  # fmt: skip
    effort = ocp.track(feet.force, weight=0.01)
    schedule = body.over(0.25, dt=0.01).without(effort) + srb.over(0.50, dt=0.05).without(limits)
    return ocp.Problem(
        models.gaits.trot(speed=0.5), schedule, objective + effort, limits, initial=body.state(joints="stand")
    )


def main(repeats: int = 3, json: bool = False, save: bool = False) -> dict[str, Any]:
    """Print and return median and 99th percentile of a plan and of its parts [ms]."""
    mpc = solvers.RecedingHorizon(problem())
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
    results: dict[str, Any] = {"benchmark": "plan_tick", "ticks": TICKS, "repeats": repeats, "ms": {}}
    for name, values in {"plan": times, **parts}.items():
        middle, high = np.percentile(1e3 * np.array(values), [50, 99])
        results["ms"][name] = {"median": round(float(middle), 3), "p99": round(float(high), 3)}
    results |= surroundings()
    lines = [f"a plan of the receding horizon; ms of the thread\n{'':8}{'median':>8}{'99 %':>8}"]
    lines += [f"{name:8}{each['median']:8.2f}{each['p99']:8.2f}" for name, each in results["ms"].items()]
    tell(results, lines, json=json, save=save)
    return results


if __name__ == "__main__":
    options = arguments(__doc__ or "", 3).parse_args()
    main(**vars(options))
