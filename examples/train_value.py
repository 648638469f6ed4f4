"""Learn the terminal value of the trot on flat ground by temporal differences, from episodes that begin at random."""

import argparse
import os
from dataclasses import replace
from pathlib import Path

import trot_mppi

from piaffe.sampling import CollectOptions, LearnOptions, train_value
from piaffe.viz import stage_bars

problem = trot_mppi.sampled_problem
follow = replace(trot_mppi.options, samples=192, first_stages=3, threads=1)
collecting = CollectOptions(
    shards=16,
    episodes=160,  # many short ones: the value must predict what follows perturbed states
    episode_steps=25,
    horizon=16,
    explore=replace(follow, sigma=1.0),
    follow=follow,
    alone=replace(follow, p_max=0.025),  # with a larger one the robot falls, because it weights the limits too much
)
learning = LearnOptions(
    updates=20_000,
    target_rate=0.02,
    weight_decay=1.0,
    hidden=(128, 128),  # larger networks overfit so few transitions
    discount=trot_mppi.options.discount,
)


def main(
    out: str = "solo12_trot.value",
    shards: int = collecting.shards,
    episodes: int = collecting.episodes,
    updates: int = learning.updates,
    workers: int = 0,
) -> float:
    """Learn the value, write its file and return its mean over the data; ``workers`` processes collect the data."""
    with stage_bars() as progress:
        value = train_value(
            problem, out, reward=trot_mppi.reward, workers=workers, progress=progress,
            collecting=replace(collecting, shards=shards, episodes=episodes),
            learning=replace(learning, updates=updates),
        )  # fmt: skip
    print(f"{Path(out).stat().st_size / 1e6:.1f} MB")
    return float(value.record["curves"]["mean_value"][-1])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="solo12_trot.value")
    parser.add_argument("--shards", type=int, default=collecting.shards)
    parser.add_argument("--episodes", type=int, default=collecting.episodes)
    parser.add_argument("--updates", type=int, default=learning.updates)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    print(f"mean value {main(**vars(parser.parse_args())):.2f}")
