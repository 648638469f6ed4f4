"""Mini Cheetah runs, flips forwards over its front legs in the middle of the run, and runs on, on random plants."""

# Keyframes, weights and phases were chosen on seeds from 500 on: benchmarks/studies/cafe/trials.md.

import argparse
from functools import lru_cache
from math import pi

import casadi as cs
from roll_then_pace import body, effort, fall, four, mpc, none, robot, run, srb
from running_roll import in_a_run, limits, speeds

from piaffe import models, ocp
from piaffe.models import stance

SPEED = 0.6  # [m/s]

__all__ = ["fall", "mpc"]  # the command line reads them


def keyframe(t: float, x: float, z: float, pitch: float, pose: str) -> ocp.Keyframe:
    """Return a keyframe of the flip at a time since its start; it goes x further ahead than the run."""
    return ocp.Keyframe(position=(SPEED * t + x, 0, z), rpy=(0, pitch, 0), joints=pose)


@ocp.inequality(lower=0.05, unit="m")
def hip_clearance(s):
    """Keep the hips off the ground while the robot turns about its front feet."""
    return cs.vertcat(*(s.frames[f"{leg}_HFE"].position[2] for leg in robot.foot_names))


front = stance("FL FR")
flip = ocp.Motion(
    ocp.Phase("tip", four, 0.16, keyframe(0.16, 0.06, 0.22, pi / 8, "crouch"), constraints=hip_clearance),
    ocp.Phase("kick", front, 0.20, keyframe(0.36, 0.10, 0.36, 0.4 * pi, "stand"), constraints=hip_clearance),
    ocp.Phase("flight", none, 0.50, keyframe(0.86, 0.40, 0.22, 2 * pi - 0.4, "stand")),
    ocp.Phase("land", four, 0.20, keyframe(1.06, 0.40, 0.22, 2 * pi, "stand")),
    ocp.Phase("settle", four, 0.20, keyframe(1.26, 0.40, 0.25, 2 * pi, "stand")),
)
trot = models.gaits.trot(speed=SPEED, velocity_gain=0.02)

# The rigid body has one inertia, and the robot's changes by a third in the flight: the whole body sees the landing when
# the robot takes off.
cascade = body.over(0.8, dt=0.01).without(effort) + srb.over(0.3, dt=0.05).without(limits)


@lru_cache(maxsize=1)
def problem() -> ocp.Problem:
    """Return the problem of trot, flip and trot; the flip follows its offline solution."""
    return in_a_run(trot, flip).with_schedule(cascade)


def main(seeds: int = 1, first: int = 0) -> float:
    """Run random plants; return the fraction that flips, and runs before and after at 0.8 of its speed or more."""
    good, declared, chosen = 0, problem(), range(first, first + seeds)
    for seed, episode in zip(chosen, run(declared, chosen, 6.0), strict=True):
        before, after = speeds(episode, declared)
        good += episode.success and min(before, after) >= 0.8 * SPEED
        end = episode.fault or ("upright" if episode.upright else "not upright")
        print(f"seed {seed}: {end}, {before:.2f} m/s before the flip, {after:.2f} m/s after it")
    return good / seeds


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    print(f"{100 * main(**vars(parser.parse_args())):.0f} %")
