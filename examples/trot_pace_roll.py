"""Mini Cheetah trots, paces, turns, rolls over sideways and trots on: three motions in one controller, by command."""

import argparse
from functools import lru_cache

from roll_then_pace import body, cascade, effort, fall, limits, objective, robot, roll

from piaffe import models, ocp, simulation, solvers
from piaffe.models import base, joints

COMMANDS = "vx=0.4 motion=pace@2 yaw=0.4@3 yaw=0@5 motion=trot@5 vx=0@6.5 motion=roll@8.5 vx=0.4@10"  # [m/s], [rad/s]

mpc = {"latency": 0.02, "retiming": solvers.Retiming(), "after": {"roll": "trot"}}


@lru_cache(maxsize=1)
def problem() -> dict[str, ocp.Problem]:
    """Return the motions: two gaits, and a roll whose path is its solution from standing."""
    initial = body.state(joints="stand")
    calm = ocp.regularize(joints.torque, weight=0.03)  # the path leaves torque to those who follow it
    alone = ocp.Problem(roll, body.until_end(dt=0.01), objective + calm, limits, initial=initial)
    path = ocp.Motion.from_solution(solvers.MSiLQR(alone).solve().raise_if_failed())
    follow = ocp.track(base.linear_velocity, weight=9.0)
    motions = {name: getattr(models.gaits, name)(speed=0.4, velocity_gain=0.02) for name in ("trot", "pace")}
    return {
        name: ocp.Problem(motion, cascade, objective + follow + effort, limits, initial=initial)
        for name, motion in {**motions, "roll": path}.items()
    }


def run(seeds: range, seconds: float = 12.0) -> list[simulation.OnlineEpisode]:
    """Run an episode for each seed, and return them."""
    planner = solvers.Motions(problem(), **mpc)
    commands, drawn, episodes = simulation.parse_commands(COMMANDS), simulation.Variation(), []
    for seed in seeds:
        planner.reset()
        low = solvers.Vwbc(planner.plan(planner.initial, 0.0), leave_out=("base.position x", "base.position y"))
        plant = simulation.Plant(robot, **drawn.numbers(simulation.Plant(robot).links, seed))
        start = drawn.start.around(plant.model, planner.initial, seed)
        episodes.append(
            simulation.run_online(
                planner,
                low,
                plant,
                seconds=seconds,
                latency=mpc["latency"],
                seed=seed,
                initial=start,
                fall=fall,
                commands=commands,
            )
        )
    return episodes


def main(seeds: int = 1, first: int = 0) -> float:
    """Run random plants, and return the fraction that goes through all motions, ends upright, and follows its speed."""
    good = 0
    for seed, episode in zip(range(first, first + seeds), run(range(first, first + seeds)), strict=True):
        names = [name for _, name in episode.motions]
        last = episode.tracking(11.0)
        speed = last.velocity[0] if last else 0.0
        good += episode.success and names == ["trot", "pace", "trot", "roll", "trot"] and speed >= 0.8 * 0.4
        told = ", ".join(f"{name} at {time:.2f} s" for time, name in episode.motions)
        print(f"seed {seed}: {told}; {episode.fault or 'upright'} after {episode.end:.2f} s, {speed:.3f} m/s of 0.40")
    return good / seeds


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    print(f"{100 * main(**vars(parser.parse_args())):.0f} %")
