"""Learn the terminal value of the trot on flat ground: sampled states, closed loops from them, temporal differences."""

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
    episodes=160,  # many and short: what counts is how perturbed states go on
    episode_steps=25,
    horizon=16,
    explore=replace(follow, sigma=1.0),
    follow=follow,
    alone=replace(follow, p_max=0.025),  # with more it falls in the attempt to keep the limits
)
learning = LearnOptions(
    updates=20_000,
    target_rate=0.02,
    weight_decay=1.0,
    hidden=(128, 128),  # larger networks learn so few transitions by heart
    discount=trot_mppi.options.discount,
)


def main(
    out: str = "solo12_trot.value",
    shards: int = collecting.shards,
    episodes: int = collecting.episodes,
    updates: int = learning.updates,
    workers: int = 0,
) -> float:
    """Learn, write the file and return the mean value of what was learned from; ``workers`` processes collect."""
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
