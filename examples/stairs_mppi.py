"""Solo12 trots up three steps of 4 cm, or up a slope, by TD-CD-MPPI with the value learnt on flat ground."""

import argparse
from dataclasses import replace
from pathlib import Path

import trot_mppi

from piaffe import sampling

sampled_problem = trot_mppi.sampled_problem
reward, value = trot_mppi.reward, trot_mppi.value
# a small p_max: with a larger one the height limit keeps the robot from climbing a step
options = replace(trot_mppi.options, p_max=0.015, temperature=0.3, sigma=0.4)
problem = sampled_problem("stairs", horizon=10)


def main(terrain: str = "stairs", horizon: int = 10, steps: int = 400, file: str = "") -> float:
    """Run one episode, with another value file or the one in this folder; return the distance covered [m]."""
    sampled = sampled_problem(terrain, horizon)
    learnt = file or Path(__file__).with_name(value)
    controller = sampling.TDCDMPPI(sampled, options, reward=reward, value=learnt, allow=("terrain", "p_max"))
    episode = sampling.run_episode(controller, steps=steps)
    print(f"{'stood' if not episode.fell else 'fell'} after {episode.times[-1]:.1f} s, {episode.distance:.2f} m")
    for name, missed in episode.missed.items():
        print(f"{name}: mean violation {100 * missed:.2f} % of its limit")
    return episode.distance


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--terrain", default="stairs", choices=list(trot_mppi.terrains))
    parser.add_argument("--horizon", type=int, default=10)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--file", default="", help="another value, made by train_value.py")
    print(f"{main(**vars(parser.parse_args())):.2f} m")
