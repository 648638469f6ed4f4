"""A trot at short horizons, at which DIAL-MPC falls and TD-CD-MPPI with a value does not; the file learns the value."""

import argparse
import os
from dataclasses import replace

import trot_mppi

from piaffe import models, ocp
from piaffe.sampling import CollectOptions, LearnOptions, train_value
from piaffe.viz import stage_bars

# As in the publication, no term has targets for the positions of the feet. If feet stay behind, the robot trips, but
# only after the end of a short horizon.
objective = ocp.Objective(*(term for term in trot_mppi.objective if term.name != "track feet.reach"))
limits = ocp.Constraints(
    models.joint_range("HAA", 0.1, scale=0.1),
    models.base_height(maximum=0.27, scale=0.27),  # steps are impossible with a lower one: knee targets end at -1.6 rad
)
centre = 2 * (0.0, 0.6, -1.1) + 2 * (0.0, -0.6, 1.1)
targets = models.joint_targets(centre=centre, half_range={"HAA": 0.4, "HFE": 0.5, "KFE": 0.5})

reward, options = trot_mppi.reward, replace(trot_mppi.options, p_max=0.05)
value = "short_horizon.value"

follow = replace(options, samples=192, first_stages=3, threads=1)
collecting = CollectOptions(
    shards=16,
    episodes=40,
    episode_steps=25,
    horizon=16,  # without a value, the robot falls with a shorter one
    explore=replace(follow, sigma=1.0),
    follow=follow,
    alone=replace(follow, p_max=0.025),  # with a larger one the robot falls, because it weights the limits too much
)
learning = LearnOptions(
    updates=9_000, target_rate=0.02, weight_decay=1.0, hidden=(64, 64), discount=options.discount
)  # fmt: skip


def sampled_problem(horizon: int = 8) -> ocp.Problem:
    """Return the trot, with a horizon in steps of 20 ms."""
    plant = models.Mujoco(trot_mppi.robot, action=targets)
    return ocp.Problem(
        trot_mppi.trot, plant.over(0.02 * horizon, dt=0.02), objective, limits, initial=trot_mppi.start
    )  # fmt: skip


problem = sampled_problem()


def main(
    out: str = value,
    shards: int = collecting.shards,
    episodes: int = collecting.episodes,
    updates: int = learning.updates,
    workers: int = 0,
) -> float:
    """Learn the value, write its file and return its mean over the data; ``workers`` processes collect the data."""
    with stage_bars() as progress:
        learnt = train_value(
            sampled_problem, out, reward=reward, workers=workers, progress=progress,
            collecting=replace(collecting, shards=shards, episodes=episodes),
            learning=replace(learning, updates=updates),
        )  # fmt: skip
    return float(learnt.record["curves"]["mean_value"][-1])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=value)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    print(f"mean value {main(**vars(parser.parse_args())):.2f}")
