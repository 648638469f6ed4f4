"""Mini Cheetah paces at 0.8 m/s, rolls over sideways out of a stance on its right feet, and paces on, on random plants."""

# Keyframes, weights and phases were chosen on seeds from 500 on: benchmarks/studies/cafe/trials.md.

import argparse
from functools import lru_cache
from math import pi

import casadi as cs
import numpy as np
from roll_then_pace import body, effort, fall, four, mpc, none, objective, right, robot, run, srb
from roll_then_pace import limits as without_knees

from piaffe import models, ocp, simulation, solvers
from piaffe.models import base, joints

SPEED = 0.8  # [m/s]
RUN_IN = 4  # cycles of the gait before the roll

__all__ = ["fall", "mpc"]  # the command line reads them


def keyframe(t: float, y: float, z: float, roll: float, pose: str) -> ocp.Keyframe:
    """Return a keyframe of the roll at a time since its start; the roll goes ahead at the speed of the pace."""
    return ocp.Keyframe(position=(SPEED * t, y, z), rpy=(roll, 0, 0), joints=pose)


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


limits = without_knees + ocp.Constraints(knee_clearance)
cascade = body.over(0.5, dt=0.01).without(effort) + srb.over(0.6, dt=0.05).without(limits)
longer = body.over(0.8, dt=0.01).without(effort) + srb.over(0.3, dt=0.05).without(limits)  # takes off as its path does


def solved(motion: ocp.Motion) -> ocp.Trajectory:
    """Return the offline solution of a motion from standing. It leaves torque to those who follow it."""
    calm = ocp.regularize(joints.torque, weight=0.03)
    sideways = ocp.track(base.position, weight=(0, 4, 0))
    onward = ocp.track(base.linear_velocity, weight=(9, 4, 0))
    offline = objective + ocp.Objective(calm, sideways, onward)
    alone = ocp.Problem(motion, body.until_end(dt=0.01), offline, limits, initial=body.state(joints="stand"))
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
    return in_a_run(pace, roll).with_schedule(longer)


def speeds(episode: simulation.OnlineEpisode, declared: ocp.Problem) -> tuple[float, float]:
    """Return the speed in the last 0.5 s before the motion in a run, and from 1 s to 2 s after it [m/s]."""
    gait, motion = declared.motion.pieces[:2]
    begins, ends = gait.duration, gait.duration + motion.duration
    found = [episode.tracking(*each) for each in ((begins - 0.5, begins), (ends + 1.0, ends + 2.0))]
    before, after = (each.velocity[0] if each else 0.0 for each in found)
    return before, after


def cleared(episode: simulation.OnlineEpisode, declared: ocp.Problem, turn: float = 0.0) -> simulation.Bar:
    """Return the highest bar, by default along the robot's heading, over which all of the robot passes."""
    begins, lasts = (piece.duration for piece in declared.motion.pieces[:2])
    over = (episode.times >= begins - 0.1) & (episode.times <= begins + lasts)
    along = turn + float(np.interp(begins, episode.times, episode.yaw))
    return simulation.highest_bar(models.mujoco_model(robot, hull=True), episode.states[over], along=along)


def main(seeds: int = 1, first: int = 0) -> float:
    """Run random plants; return the fraction that runs in at 0.7 m/s, clears a bar of 0.35 m and runs on at 0.64 m/s."""
    good, chosen = 0, range(first, first + seeds)
    for seed, episode in zip(chosen, run(problem(), chosen, 6.0), strict=True):
        (before, after), apex = speeds(episode, problem()), float(episode.states[:, 2].max())
        bar = cleared(episode, problem()).height if not episode.fell else 0.0
        good += episode.success and before >= 0.7 and apex >= 0.50 and bar >= 0.35 and after >= 0.64
        end = episode.fault or ("upright" if episode.upright else "not upright")
        print(f"seed {seed}: {end}, {before:.2f} m/s, apex {apex:.2f} m, bar {bar:.2f} m, {after:.2f} m/s")
    return good / seeds


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    print(f"{100 * main(**vars(parser.parse_args())):.0f} %")
