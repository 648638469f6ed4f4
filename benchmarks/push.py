"""How often a bound survives a push: 12 phases of the cycle, three directions, four low levels on the same plans.

The base's velocity changes by 1.5 or 2.0 m/s within 50 ms [Li2025CafeMpc]; 2.5 m/s is added because robots survive most
of the others. All low levels have the same joint gains, and their torques are clipped. A bound survives if it has not
fallen, and is upright, 3 s later.
"""

from __future__ import annotations

import sys
from typing import Any

from common import arguments, example, surroundings, tell

from piaffe import models, ocp, simulation, solvers

START, CYCLE, PHASES, AFTER = 2.0, 0.4, 12, 3.0  # [s], [s], 1, [s]
DIRECTIONS = {"y": (0.0, 1.0, 0.0), "x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0)}
LEAVE_OUT = ("base.position x", "base.position y")
LOWS = ("Vwbc", "Vwbc, measured contacts", "Riccati", "FeedforwardPD")


def problem(rotors: bool) -> ocp.Problem:
    """Return the bound of ``examples/bound_mpc.py``, with rotors and losses of joints or without."""
    bound = example("bound_mpc")
    if rotors:
        return bound.problem
    robot = models.load("mini_cheetah")
    body, srb = models.WholeBody(robot), models.SingleRigidBody(robot)
    cascade = body.over(0.25, dt=0.01).without(bound.effort) + srb.over(0.50, dt=0.05).without(bound.limits)
    return ocp.Problem(
        bound.bound, cascade, bound.objective + bound.effort, bound.limits, initial=bound.problem.initial
    )


def low_level(name: str, plan: solvers.Plan, contact_of: Any) -> solvers.LowLevel:
    """Return a low level with the published joint gains, a quarter of them in stance."""
    kp, kd = 3.0, (1.0, 0.5, 0.5) * 4
    if name == "FeedforwardPD":
        return solvers.FeedforwardPD(plan, kp=kp, kd=kd, in_stance=0.25, contact_of=contact_of)
    gains = solvers.JointPD(kp, kd, in_stance=0.25, contact_of=contact_of)
    if name == "Riccati":
        return solvers.Riccati(plan, gains=gains, leave_out=LEAVE_OUT)
    contacts: Any = "measured" if name.endswith("measured contacts") else "schedule"
    return solvers.Vwbc(plan, gains=gains, leave_out=LEAVE_OUT, contacts=contacts)


def survived(mpc: solvers.RecedingHorizon, name: str, speed: float, axis: tuple[float, float, float]) -> int:
    """Return how many of the pushes along an axis, at 12 phases of the cycle, the robot survives."""
    robot, count = mpc.problem.schedule.segments[0].model.robot, 0
    for k in range(PHASES):
        mpc.reset()
        low = low_level(name, mpc.plan(mpc.initial, 0.0), robot.foot_of_joint)
        start = round(START + CYCLE * k / PHASES, 3)
        push = simulation.Push(time=start, velocity=tuple(speed * each for each in axis))
        plant = simulation.Plant(robot, friction=0.7)
        count += simulation.run_online(mpc, low, plant, seconds=round(start + AFTER, 2), pushes=[push]).success
    return count


def main(speeds: list[float], json: bool = False, save: bool = False) -> dict[str, Any]:
    """Print and return the number of survived pushes of 12, by rotors, speed, low level and direction."""
    rows: list[dict[str, Any]] = []
    lines = [f"survived pushes of {PHASES}, by direction", f"{'':34s}" + "".join(f"{d:>5s}" for d in DIRECTIONS)]
    for rotors in (True, False):
        mpc = solvers.RecedingHorizon(problem(rotors))
        for speed in speeds:
            for name in LOWS:
                found = {way: survived(mpc, name, speed, axis) for way, axis in DIRECTIONS.items()}
                rows.append({"rotors": rotors, "speed_m_per_s": speed, "low": name, **found})
                what = f"{'rotors' if rotors else 'no rotors'}, {speed:.1f} m/s, {name}"
                lines.append(f"{what:34s}" + "".join(f"{count:5d}" for count in found.values()))
                print(lines[-1], file=sys.stderr, flush=True)
    results = {"benchmark": "push", "phases": PHASES, "rows": rows, **surroundings()}
    tell(results, lines, json=json, save=save)
    return results


if __name__ == "__main__":
    parser = arguments(__doc__ or "", 1)
    parser.add_argument("--speeds", type=float, nargs="+", default=[1.5, 2.0, 2.5], help="changes of velocity [m/s]")
    options = vars(parser.parse_args())
    options.pop("repeats")  # the episodes are deterministic
    main(**options)
