"""Mini Cheetah paces at 0.8 m/s, rolls over sideways out of a stance on its right feet, and paces on, on random plants."""

import argparse
from dataclasses import dataclass
from functools import lru_cache
from math import pi

import casadi as cs
import numpy as np

from piaffe import models, ocp, simulation, solvers
from piaffe.models import base, feet, joints, stance

SPEED = 0.8  # [m/s]
RUN_IN = 4  # cycles of the pace before the roll

robot = models.load("mini_cheetah", rotors=True, joint_damping=0.01, joint_friction=0.2)  # [Nm s/rad], [Nm]
body = models.WholeBody(robot)
srb = models.SingleRigidBody(robot)


def keyframe(t: float, y: float, z: float, roll: float, pose: str) -> ocp.Keyframe:
    """Return a keyframe of the roll at a time since its start; the roll goes ahead at the speed of the pace."""
    return ocp.Keyframe(position=(SPEED * t, y, z), rpy=(roll, 0, 0), joints=pose)


four, right, none = stance("FL FR HL HR"), stance("FR HR"), stance("")
roll = ocp.Motion(
    ocp.Phase("lean", right, 0.24, keyframe(0.24, -0.30, 0.33, pi / 2, "lean")),
    ocp.Phase("flight", none, 0.47, keyframe(0.71, -0.95, 0.22, 2 * pi, "tuck")),
    ocp.Phase("land", four, 0.15, keyframe(0.86, -0.95, 0.25, 2 * pi, "tuck")),
    ocp.Phase("hop", none, 0.20, keyframe(1.06, -0.95, 0.25, 2 * pi, "stand")),
    ocp.Phase("settle", four, 0.15, keyframe(1.21, -0.95, 0.25, 2 * pi, "stand")),
)
pace = models.gaits.pace(speed=SPEED, velocity_gain=0.02)


@ocp.inequality(lower=0.03, unit="m", when=("land", "settle"))
def knee_clearance(s):
    """Keep the knees off the ground where the robot lands."""
    return cs.vertcat(*(s.frames[f"{leg}_KFE"].position[2] for leg in robot.foot_names))


# The objective and limits of roll_then_pace.py, for the pace and the roll.
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
    models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0), knee_clearance,
)  # fmt: skip
effort = ocp.regularize(feet.force, weight=0.02)
cascade = body.over(0.5, dt=0.01).without(effort) + srb.over(0.6, dt=0.05).without(limits)

mpc = {"latency": 0.02, "retiming": solvers.Retiming()}
fall = models.Fall(tilt=pi, height=0.06)  # a roll is no fall


def solved(motion: ocp.Motion) -> ocp.Trajectory:
    """Return the offline solution of a motion from standing. It leaves torque to those who follow it."""
    terms = (
        ocp.regularize(joints.torque, weight=0.03),
        ocp.track(base.position, weight=(0, 4, 0)),
        ocp.track(base.linear_velocity, weight=(9, 4, 0)),
    )
    alone = ocp.Problem(
        motion, body.until_end(dt=0.01), objective + ocp.Objective(*terms), limits, initial=body.state(joints="stand")
    )
    return solvers.MSiLQR(alone).solve().raise_if_failed().trajectory


def between(gait: ocp.Motion, motion: ocp.Motion) -> ocp.Motion:
    """Return a motion as the part of an offline solution between two cycles of a gait and one more cycle."""
    begun = ocp.Motion.from_trajectory(solved(gait.cycles(2) + motion))  # the first guess of the whole
    whole = solved(begun + gait.cycles(1))
    names = {phase.name for piece in motion.pieces for phase in piece.phases}
    return ocp.Motion.from_trajectory(ocp.Trajectory(tuple(each for each in whole.phases if each.name in names)))


def in_a_run(gait: ocp.Motion, motion: ocp.Motion) -> ocp.Problem:
    """Return the problem of a gait, a motion and the gait again; the motion follows its offline solution."""
    whole = gait.cycles(RUN_IN) + between(gait, motion) + gait
    follow = ocp.track(base.linear_velocity, weight=9.0)
    return ocp.Problem(whole, cascade, objective + follow + effort, limits, initial=body.state(joints="stand"))


@lru_cache(maxsize=1)
def problem() -> ocp.Problem:
    """Return the problem of pace, roll and pace."""
    return in_a_run(pace, roll)


def run(declared: ocp.Problem, seeds: range, seconds: float = 6.0) -> list[simulation.OnlineEpisode]:
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


@dataclass(frozen=True)
class Judgement:
    """What an episode shows.

    Args:
        ends: ``"upright"``, or how it ends.
        runs_in: speed in the last cycle of the pace before the roll [m/s].
        apex: largest height of the base [m].
        bar: height of the highest bar along the robot's heading over which all of the robot passes [m].
        runs_on: speed from 1 s to 2 s after the roll [m/s].
    """

    ends: str
    runs_in: float
    apex: float
    bar: float
    runs_on: float

    @property
    def good(self) -> bool:
        """Whether the robot runs in, rolls over a bar and runs on."""
        fast = self.runs_in >= 0.7 and self.runs_on >= 0.8 * SPEED
        return self.ends == "upright" and fast and self.apex >= 0.50 and self.bar >= 0.35


def judged(episode: simulation.OnlineEpisode) -> Judgement:
    """Return what an episode shows."""
    gait, path = problem().motion.pieces[:2]
    begins, ends = gait.duration, gait.duration + path.duration
    speeds = [episode.tracking(*each) for each in ((begins - 0.5, begins), (ends + 1.0, ends + 2.0))]
    runs_in, runs_on = (each.velocity[0] if each else 0.0 for each in speeds)
    rolls = (episode.times >= begins - 0.1) & (episode.times <= ends)
    bar = 0.0
    if rolls.sum() > 1:
        shapes = models.mujoco_model(robot, contacts="none", hull=True)
        heading = float(np.interp(begins, episode.times, episode.yaw))
        bar = simulation.highest_bar(shapes, episode.states[rolls], along=heading).height
    ends_as = episode.fault or ("upright" if episode.upright else "not upright")
    return Judgement(ends_as, runs_in, float(episode.states[:, 2].max()), bar, runs_on)


def main(seeds: int = 1, first: int = 0) -> float:
    """Run random plants; return the fraction that runs in at 0.7 m/s, clears a bar of 0.35 m and runs on at 0.64 m/s."""
    good = 0
    for seed, episode in zip(range(first, first + seeds), run(problem(), range(first, first + seeds)), strict=True):
        found = judged(episode)
        good += found.good
        print(
            f"seed {seed}: {found.ends}, runs in at {found.runs_in:.2f} m/s, apex {found.apex:.2f} m, "
            f"bar {found.bar:.2f} m, runs on at {found.runs_on:.2f} m/s"
        )
    return good / seeds


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    print(f"{100 * main(**vars(parser.parse_args())):.0f} %")
