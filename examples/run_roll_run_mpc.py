"""Mini Cheetah runs, stops on all feet, rolls over sideways and runs on: a trot or a pace, on random plants."""

import argparse
from functools import lru_cache
from math import pi

from roll_then_pace import fall, four, mpc, none, right, run
from running_roll import in_a_run, speeds

from piaffe import models, ocp

SPEED = 0.6  # [m/s]

__all__ = ["fall", "mpc"]  # the command line reads them


def keyframe(t: float, y: float, z: float, roll: float, pose: str) -> ocp.Keyframe:
    """Return a keyframe of the roll at a time since its start; the roll goes ahead at half the speed of the gait."""
    return ocp.Keyframe(position=(0.5 * SPEED * t, y, z), rpy=(roll, 0, 0), joints=pose)


roll = ocp.Motion(
    ocp.Phase("push", four, 0.12, keyframe(0.12, -0.15, 0.26, pi / 6, "crouch")),
    ocp.Phase("lean", right, 0.21, keyframe(0.33, -0.25, 0.33, pi / 2, "lean")),
    ocp.Phase("flight", none, 0.42, keyframe(0.75, -0.55, 0.22, 2 * pi, "tuck")),
    ocp.Phase("land", four, 0.15, keyframe(0.90, -0.55, 0.25, 2 * pi, "tuck")),
    ocp.Phase("hop", none, 0.20, keyframe(1.10, -0.55, 0.25, 2 * pi, "stand")),
    ocp.Phase("settle", four, 0.15, keyframe(1.25, -0.55, 0.25, 2 * pi, "stand")),
)


@lru_cache(maxsize=2)
def problem(gait: str = "trot") -> ocp.Problem:
    """Return the problem of a gait, ``"trot"`` or ``"pace"``, the roll, and the gait again."""
    return in_a_run(getattr(models.gaits, gait)(speed=SPEED, velocity_gain=0.02), roll)


def main(seeds: int = 1, first: int = 0, gait: str = "trot") -> float:
    """Run random plants; return the fraction that runs before and after the roll at 0.8 of its speed or more."""
    good, declared = 0, problem(gait)
    for seed, episode in zip(range(first, first + seeds), run(declared, range(first, first + seeds), 6.0), strict=True):
        before, after = speeds(episode, declared)
        good += episode.success and min(before, after) >= 0.8 * SPEED
        end = episode.fault or ("upright" if episode.upright else "not upright")
        print(f"{gait}, seed {seed}: {end}, {before:.2f} m/s before the roll, {after:.2f} m/s after it")
    return good / seeds


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--gait", choices=("trot", "pace"), default="trot")
    print(f"{100 * main(**vars(parser.parse_args())):.0f} %")
