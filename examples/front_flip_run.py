"""Mini Cheetah runs, flips forwards in the middle of the run, and runs on, on random plants."""

import argparse
from functools import lru_cache
from math import pi

from roll_then_pace import fall, four, mpc, none, run
from running_roll import in_a_run, speeds

from piaffe import models, ocp
from piaffe.models import stance

SPEED = 0.6  # [m/s]

__all__ = ["fall", "mpc"]  # the command line reads them


def keyframe(t: float, z: float, pitch: float, pose: str) -> ocp.Keyframe:
    """Return a keyframe of the flip at a time since its start; the flip goes ahead at the speed of the run."""
    return ocp.Keyframe(position=(SPEED * t, 0, z), rpy=(0, pitch, 0), joints=pose)


hind = stance("HL HR")
flip = ocp.Motion(
    ocp.Phase("crouch", four, 0.16, keyframe(0.16, 0.20, -0.1, "crouch")),
    ocp.Phase("kick",   hind, 0.16, keyframe(0.32, 0.36, 0.25 * pi, "stand")),
    ocp.Phase("flight", none, 0.45, keyframe(0.77, 0.22, 2 * pi, "stand")),
    ocp.Phase("land",   four, 0.20, keyframe(0.97, 0.22, 2 * pi, "stand")),
    ocp.Phase("settle", four, 0.20, keyframe(1.17, 0.25, 2 * pi, "stand")),
)  # fmt: skip
trot = models.gaits.trot(speed=SPEED, velocity_gain=0.02)


@lru_cache(maxsize=1)
def problem() -> ocp.Problem:
    """Return the problem of trot, flip and trot."""
    return in_a_run(trot, flip)


def main(seeds: int = 1, first: int = 0) -> float:
    """Run random plants; return the fraction that flips, and runs before and after at 0.8 of its speed or more."""
    good, declared = 0, problem()
    for seed, episode in zip(range(first, first + seeds), run(declared, range(first, first + seeds), 6.0), strict=True):
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
