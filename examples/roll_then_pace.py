"""Mini Cheetah rolls over sideways, lands and paces away, with a receding horizon, on plants that vary."""

import argparse
from functools import lru_cache
from math import pi

from piaffe import models, ocp, simulation, solvers
from piaffe.models import base, feet, joints, stance

SPEED = 0.5  # [m/s]

robot = models.load("mini_cheetah", rotors=True, joint_damping=0.01, joint_friction=0.2)  # [Nm s/rad], [Nm]
body = models.WholeBody(robot)
srb = models.SingleRigidBody(robot)

four, right, none = stance("FL FR HL HR"), stance("FR HR"), stance("")
roll = ocp.Motion(
    ocp.Phase("push", four, 0.12, ocp.Keyframe(position=(0, -0.15, 0.26), rpy=(pi / 6, 0, 0), joints="crouch")),
    ocp.Phase("lean", right, 0.21, ocp.Keyframe(position=(0, -0.25, 0.33), rpy=(pi / 2, 0, 0), joints="lean")),
    ocp.Phase("flight", none, 0.42, ocp.Keyframe(position=(0, -0.55, 0.22), rpy=(2 * pi, 0, 0), joints="tuck")),
    ocp.Phase("land", four, 0.15, ocp.Keyframe(position=(0, -0.55, 0.25), rpy=(2 * pi, 0, 0), joints="tuck")),
    ocp.Phase("hop", none, 0.20, ocp.Keyframe(position=(0, -0.55, 0.25), rpy=(2 * pi, 0, 0), joints="stand")),
    ocp.Phase("settle", four, 0.15, ocp.Keyframe(position=(0, -0.55, 0.25), rpy=(2 * pi, 0, 0), joints="stand")),
)
pace = models.gaits.pace(speed=SPEED, velocity_gain=0.02)

# One objective for the roll and the gait. Its weights were chosen by hand on seeds 1000 to 1039 of main().
objective = ocp.Objective(
    ocp.track(base.position, weight=(0, 1, 30)),
    ocp.track(base.orientation, weight=(5, 2, 2)),
    ocp.track(base.linear_velocity, weight=1.0),
    ocp.track(base.angular_velocity, weight=1.0),
    ocp.track(joints.position, weight=1.0),
    ocp.track(joints.velocity, weight=0.05),
    ocp.regularize(joints.torque, weight=0.02),
    ocp.track(base.position, weight=(0, 1, 50), at="phase_end"),
    ocp.track(base.orientation, weight=(10, 5, 5), at="phase_end"),
    ocp.track(joints.position, weight=1.0, at="phase_end"),
)
limits = ocp.Constraints(
    models.friction_cone(mu=0.6), models.torque_limits(0.9), models.joint_limits(), models.joint_speed_limits(),
    models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0),
)  # fmt: skip
effort = ocp.regularize(feet.force, weight=0.02)
cascade = body.over(0.5, dt=0.01).without(effort) + srb.over(0.6, dt=0.05).without(limits)

mpc = {"latency": 0.02, "retiming": solvers.Retiming()}
fall = models.Fall(tilt=pi, height=0.06)  # a roll is no fall


@lru_cache(maxsize=1)
def problem() -> ocp.Problem:
    """Return the problem: the path of the roll is its solution from standing, and the pace follows where it ends."""
    initial = body.state(joints="stand")
    calm = ocp.regularize(joints.torque, weight=0.03)  # the path leaves torque to those who follow it
    alone = ocp.Problem(roll, body.until_end(dt=0.01), objective + calm, limits, initial=initial)
    path = ocp.Motion.from_solution(solvers.MSiLQR(alone).solve().raise_if_failed())
    follow = ocp.track(base.linear_velocity, weight=9.0)
    return ocp.Problem(path + pace, cascade, objective + follow + effort, limits, initial=initial)


def run(declared: ocp.Problem, seeds: range, seconds: float = 4.0) -> list[simulation.OnlineEpisode]:
    """Run an episode of a problem for each seed, and return them."""
    planner = solvers.RecedingHorizon(declared, **mpc)
    drawn, episodes = simulation.Variation(), []
    for seed in seeds:
        planner.reset()
        low = solvers.Vwbc(planner.plan(declared.initial, 0.0), leave_out=("base.position x", "base.position y"))
        plant = simulation.Plant(robot, **drawn.numbers(simulation.Plant(robot).links, seed))
        start = drawn.start.around(plant.model, declared.initial, seed)
        episodes.append(
            simulation.run_online(
                planner, low, plant, seconds=seconds, latency=mpc["latency"], seed=seed, initial=start, fall=fall
            )
        )
    return episodes


def main(seeds: int = 1, first: int = 0) -> float:
    """Roll and pace on random plants, and return the fraction that ends upright, and paces at 0.8 of its speed or more."""
    good = 0
    for seed, episode in zip(range(first, first + seeds), run(problem(), range(first, first + seeds)), strict=True):
        found = episode.tracking(3.0)
        speed = found.velocity[0] if found else 0.0
        good += episode.success and speed >= 0.8 * SPEED
        end = episode.fault or ("upright" if episode.upright else "not upright")
        print(f"seed {seed}: {end} after {episode.end:.2f} s, {speed:.3f} m/s of {SPEED:.2f}")
    return good / seeds


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    print(f"{100 * main(**vars(parser.parse_args())):.0f} %")
