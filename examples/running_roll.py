"""Mini Cheetah paces at 0.8 m/s, rolls over sideways out of a stance on its right feet, and paces on, on random plants."""

import argparse
from functools import lru_cache
from math import pi

from piaffe import models, ocp, simulation, solvers
from piaffe.models import base, feet, joints, stance

SPEED = 0.8  # [m/s]
RUN_IN = 4  # cycles of the pace before the roll

robot = models.load("mini_cheetah", rotors=True, joint_damping=0.01, joint_friction=0.2)  # [Nm s/rad], [Nm]
body = models.WholeBody(robot)
srb = models.SingleRigidBody(robot)


def keyframe(t: float, y: float, z: float, roll: float, pose: str) -> ocp.Keyframe:
    """Return a keyframe of the roll at a time since its start, which goes ahead at the speed of the pace."""
    return ocp.Keyframe(position=(SPEED * t, y, z), rpy=(roll, 0, 0), joints=pose)


four, right, none = stance("FL FR HL HR"), stance("FR HR"), stance("")
roll = ocp.Motion(
    ocp.Phase("lean", right, 0.24, keyframe(0.24, -0.20, 0.33, pi / 2, "lean")),
    ocp.Phase("flight", none, 0.47, keyframe(0.71, -0.60, 0.22, 2 * pi, "tuck")),
    ocp.Phase("land", four, 0.15, keyframe(0.86, -0.60, 0.25, 2 * pi, "tuck")),
    ocp.Phase("hop", none, 0.20, keyframe(1.06, -0.60, 0.25, 2 * pi, "stand")),
    ocp.Phase("settle", four, 0.15, keyframe(1.21, -0.60, 0.25, 2 * pi, "stand")),
)
pace = models.gaits.pace(speed=SPEED, velocity_gain=0.02)

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


def solved(motion: ocp.Motion) -> ocp.Trajectory:
    """Return the offline solution of a motion from standing; it leaves torque to those who follow it."""
    terms = ocp.regularize(joints.torque, weight=0.03), ocp.track(base.linear_velocity, weight=(9, 0, 0))
    alone = ocp.Problem(
        motion, body.until_end(dt=0.01), objective + ocp.Objective(*terms), limits, initial=body.state(joints="stand")
    )
    return solvers.MSiLQR(alone).solve().raise_if_failed().trajectory


def path() -> ocp.Motion:
    """Return the roll of an offline solution of pace, roll and pace."""
    run_in = ocp.Motion.from_trajectory(solved(pace.cycles(2) + roll))
    whole = solved(run_in + pace.cycles(1))
    names = {phase.name for piece in roll.pieces for phase in piece.phases}
    return ocp.Motion.from_trajectory(ocp.Trajectory(tuple(each for each in whole.phases if each.name in names)))


@lru_cache(maxsize=1)
def problem() -> ocp.Problem:
    """Return the problem: the pace follows its command, and the roll follows its offline solution."""
    motion = pace.cycles(RUN_IN) + path() + pace
    follow = ocp.track(base.linear_velocity, weight=9.0)
    return ocp.Problem(motion, cascade, objective + follow + effort, limits, initial=body.state(joints="stand"))


def run(seeds: range) -> list[simulation.OnlineEpisode]:
    """Run an episode of 6 s for each seed, and return them."""
    declared = problem()
    planner = solvers.RecedingHorizon(declared, **mpc)
    drawn, episodes = simulation.Variation(), []
    for seed in seeds:
        planner.reset()
        low = solvers.Vwbc(planner.plan(declared.initial, 0.0), leave_out=("base.position x", "base.position y"))
        plant = simulation.Plant(robot, **drawn.numbers(simulation.Plant(robot).links, seed))
        start = drawn.start.around(plant.model, declared.initial, seed)
        episodes.append(
            simulation.run_online(
                planner, low, plant, seconds=6.0, latency=mpc["latency"], seed=seed, initial=start, fall=fall
            )
        )
    return episodes
