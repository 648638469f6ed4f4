"""How often a bound survives a push: 12 phases of the cycle, three directions, three low levels on the same plans.

The base's velocity changes by 1.5 or 2.0 m/s within 50 ms [Li2025CafeMpc]. All low levels have the same joint gains,
and their torques are clipped. A bound survives if it has not fallen, and is upright, 3 s later.
"""

from __future__ import annotations

from typing import Any

from common import arguments, surroundings, tell

from piaffe import models, ocp, simulation, solvers

START, CYCLE, PHASES, AFTER = 2.0, 0.4, 12, 3.0  # [s], [s], 1, [s]
DIRECTIONS = {"y": (0.0, 1.0, 0.0), "x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0)}
LEAVE_OUT = ("base.position x", "base.position y")
LOWS = ("Vwbc", "Riccati", "FeedforwardPD")


def problem(rotors: bool) -> ocp.Problem:
    """Return the bound of ``examples/bound_mpc.py``, with rotors and losses of joints or without."""
    from importlib.util import module_from_spec, spec_from_file_location
    from pathlib import Path

    spec = spec_from_file_location("bound_mpc", Path(__file__).parents[1] / "examples" / "bound_mpc.py")
    assert spec is not None  # the file is there
    assert spec.loader is not None
    example = module_from_spec(spec)
    spec.loader.exec_module(example)
    if rotors:
        return example.problem
    robot = models.load("mini_cheetah")
    body, srb = models.WholeBody(robot), models.SingleRigidBody(robot)
    cascade = body.over(0.25, dt=0.01).without(example.effort) + srb.over(0.50, dt=0.05).without(example.limits)
    return ocp.Problem(
        example.bound, cascade, example.objective + example.effort, example.limits, initial=example.problem.initial
    )


def main(repeats: int = 1, json: bool = False, save: bool = False) -> dict[str, Any]:
    """Print and return the number of survived pushes of 12, by rotors, speed, low level and direction."""
    table: dict[str, Any] = {}
    for rotors in (True, False):
        declared = problem(rotors)
        robot = declared.schedule.segments[0].model.robot
        mpc = solvers.RecedingHorizon(declared)
        for speed in (1.5, 2.0):
            for name in LOWS:
                own = table[f"{'rotors' if rotors else 'no rotors'}, {speed} m/s, {name}"] = {}
                for direction, axis in DIRECTIONS.items():
                    own[direction] = 0
                    for k in range(PHASES):
                        mpc.reset()
                        plan = mpc.plan(declared.initial, 0.0)
                        gains = solvers.JointPD(
                            3.0, (1.0, 0.5, 0.5) * 4, in_stance=0.25, contact_of=robot.foot_of_joint
                        )
                        leave_out = {} if name == "FeedforwardPD" else {"leave_out": LEAVE_OUT}
                        low = getattr(solvers, name)(plan, gains=gains, **leave_out)
                        start = round(START + CYCLE * k / PHASES, 3)
                        push = simulation.Push(time=start, velocity=tuple(speed * each for each in axis))
                        plant = simulation.Plant(robot, friction=0.7)
                        episode = simulation.run_online(mpc, low, plant, seconds=round(start + AFTER, 2), pushes=[push])
                        own[direction] += episode.success
    result = {"phases": PHASES, "survived": table, **surroundings()}
    tell(result, json, save, __file__)
    return result


if __name__ == "__main__":
    main(**vars(arguments(__doc__, 1).parse_args()))
