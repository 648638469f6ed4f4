"""Solo12 trots towards three steps of 4 cm, or up a slope, by TD-CD-MPPI, with a value from flat ground if one is given."""

import argparse

import trot_mppi

from piaffe import sampling

sampled_problem = trot_mppi.sampled_problem
reward, options = trot_mppi.reward, trot_mppi.options
problem = sampled_problem("stairs", horizon=10)


def main(terrain: str = "stairs", horizon: int = 10, steps: int = 400, value: str | None = None) -> float:
    """Run one episode and return the distance that was covered [m]."""
    sampled = sampled_problem(terrain, horizon)
    controller = sampling.TDCDMPPI(sampled, options, reward=reward, value=value, allow=("terrain",))
    episode = sampling.run_episode(controller, steps=steps)
    print(f"{'stood' if not episode.fell else 'fell'} after {episode.times[-1]:.1f} s, {episode.distance:.2f} m")
    for name, missed in episode.missed.items():
        print(f"{name}: {100 * missed:.2f} % beyond its limit in the mean")
    return episode.distance


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--terrain", default="stairs", choices=list(trot_mppi.terrains))
    parser.add_argument("--horizon", type=int, default=10)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--value", help="made by train_value.py")
    print(f"{main(**vars(parser.parse_args())):.2f} m")
