"""Time one iteration of the published schedules S0 to S20: 0.25 s of whole body, then more and more of the rigid body.

Mini Cheetah paces, trots with flight, pronks and bounds within its limits; the whole body steps 10 ms, the rigid
body 10 or 50 ms. One thread. The published solver took 4.0 ms for an iteration of S5 with 50 ms on such a machine.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"

from functools import cache
from statistics import median
from typing import Any

from common import arguments, begin, iteration, machine_at, middle, profile, solve, steps, surroundings, tell

from piaffe import models, ocp
from piaffe.models import base, feet, joints
from piaffe.solvers.ilqr.native.library import library_for
from piaffe.solvers.ilqr.native.memory import SolverMemory

GAITS = {
    "pace": models.gaits.pace, "flying trot": models.gaits.flying_trot, "pronk": models.gaits.pronk,
    "bound": models.gaits.bound,
}  # fmt: skip
HEAD, HEAD_DT = 0.25, 0.01  # [s]
TAILS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0, 1.5, 2.0)  # [s]
TAIL_DTS = (0.01, 0.05)  # [s]
SPEED = 0.5  # [m/s]
ITERATIONS = 12  # of a solve
CALLS = 5  # of the parts per turn: the least of them was not interrupted


def swing(s):
    """1 for feet in the air."""
    return 1 - s.feet.contact


@cache
def declaration() -> tuple[models.WholeBody, models.SingleRigidBody, ocp.Objective, ocp.Cost, ocp.Constraints]:
    """Return models, objective, the tail's effort and limits, which all schedules share."""
    robot = models.load("mini_cheetah")
    walking = ocp.Objective(
        ocp.track(base.position, weight=(0, 0, 50)),
        ocp.track(base.orientation, weight=(2, 2, 1)),
        ocp.track(base.linear_velocity, weight=2.0),
        ocp.track(base.angular_velocity, weight=(2, 2, 1)),
        ocp.track(joints.position, weight=1.0),
        ocp.track(joints.velocity, weight=0.01),
        ocp.track(feet.position, weight=10.0, mask=swing),
        ocp.regularize(joints.torque, weight=0.02),
        ocp.track(base.position, weight=(0, 0, 10), at="phase_end"),
        ocp.track(base.orientation, weight=1.0, at="phase_end"),
    )
    limits = ocp.Constraints(
        models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(), models.joint_speed_limits(),
        models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0),
    )  # fmt: skip
    effort = ocp.track(feet.force, weight=0.01)
    return models.WholeBody(robot), models.SingleRigidBody(robot), walking, effort, limits


def cascade(gait: ocp.Motion, tail: float, tail_dt: float) -> ocp.CompiledProblem:
    """Return the problem of a gait and a schedule."""
    body, srb, walking, effort, limits = declaration()
    schedule = body.over(HEAD, dt=HEAD_DT).without(effort)
    if tail:
        schedule = schedule + srb.over(tail, dt=tail_dt).without(limits)
    problem = ocp.Problem(gait, schedule, walking + effort, limits, initial=body.state(joints="stand"))
    return ocp.compile_problem(problem)


def sample(machine: SolverMemory) -> dict[str, float]:
    """Time the parts of an iteration and iterations of a solve, which may take several trials [s].

    The mean is of this thread, over those after the first; the median is of those accepted, on the clock.
    """
    parts = profile(machine, CALLS)
    begin(machine)
    once = solve(machine, 1)
    begin(machine)
    took = solve(machine, ITERATIONS) - once
    ends = [machine.history[j].wall_s for j in range(machine.c.num_records)]
    accepted = [b - a for a, b, size in zip(ends, ends[1:], steps(machine)[1:], strict=False) if size > 0]
    mean = took / (len(ends) - 1)
    return {**parts, "iteration": iteration(parts), "mean in a solve": mean, "accepted in a solve": median(accepted)}


def main(repeats: int = 15, json: bool = False, save: bool = False) -> dict[str, Any]:
    """Print and return the median times of an iteration [ms]."""
    cases = [(gait, dt, tail) for gait in GAITS for dt in TAIL_DTS for tail in TAILS]
    machines = {}
    for gait, dt, tail in cases:
        machines[gait, dt, tail] = machine_at(cascade(GAITS[gait](SPEED), tail, dt))
    samples: dict[Any, list[dict[str, float]]] = {case: [] for case in cases}
    for _ in range(repeats):
        for case in cases:  # in turns, so that whatever else the machine does disturbs all alike
            samples[case].append(sample(machines[case]))
    rows = []
    for gait, dt, tail in cases:
        problem = machines[gait, dt, tail].problem
        rows.append({
            "gait": gait, "schedule": f"S{round(10 * tail)}", "tail_dt": dt, "tail": tail,
            "nodes": problem.num_stages, "phases": len(problem.phases), "ms": middle(samples[gait, dt, tail], 1e3, 4),
        })  # fmt: skip
    ratios = {
        gait: round(median(_over(samples[gait, 0.05, 2.0], samples[gait, 0.05, 0.5], "iteration")), 3) for gait in GAITS
    }
    results: dict[str, Any] = {
        "benchmark": "cascade", "repeats": repeats, "schedules": rows, "S20 / S5 at 50 ms": ratios,
        **surroundings(library_for(machines[cases[0]].problem)[0].built),
    }  # fmt: skip
    lines = ["median ms per iteration: sum of its parts | iterations of a solve, with all their trials"]
    for gait in GAITS:
        for dt in TAIL_DTS:
            own = [row for row in rows if row["gait"] == gait and row["tail_dt"] == dt]
            lines.append(f"{gait:12} dt_s {1e3 * dt:3.0f} ms  " + "".join(f"{row['schedule']:>14}" for row in own))
            told = (
                f"{row['ms']['iteration']['median']:.3f}|{row['ms']['mean in a solve']['median']:.3f}" for row in own
            )
            lines.append(f"{'':24}" + "".join(f"{text:>14}" for text in told))
        lines.append(f"{'':24}S20 / S5 at 50 ms: {ratios[gait]:.2f}")
    tell(results, lines, json=json, save=save)
    return results


def _over(a: list[dict[str, float]], b: list[dict[str, float]], name: str) -> list[float]:
    return [x[name] / y[name] for x, y in zip(a, b, strict=True)]


if __name__ == "__main__":
    main(**vars(arguments(__doc__, repeats=15).parse_args()))
