"""Two user-defined samplers, the cross-entropy method and predictive sampling: Solo12 trots with each of them."""

import argparse

import numpy as np
import trot_mppi

from piaffe import sampling

problem, reward = trot_mppi.sampled_problem, trot_mppi.reward


class CEM(sampling.Sampler):
    """The cross-entropy method: the plan is the mean of the best samples, their deviation that of the next stage."""

    title = "CEM"
    # chosen on seeds 10, 11 and 12, on which one stage and a horizon of 12 steps trot, too
    defaults = sampling.Options(samples=256, sigma=0.5, node_factor=0.9, stages=2, first_stages=6)
    elites = 0.1  # fraction of the samples
    least = 0.05  # smallest deviation, relative to half of the controls' range

    def initial_memory(self):
        """Return the deviation of every node."""
        return {"deviation": np.full((self.options.knots + 1, len(self.model.action.centre)), self.options.sigma)}

    def sample(self, xp, plan, noise, stage, memory):
        """Return perturbed plans; the first stage has the options' deviation, the others that of the best samples."""
        return plan + xp.where(stage.index == 0, stage.deviation, memory["deviation"]) * noise

    def returns(self, xp, rolled, memory):
        """Return the mean reward."""
        return self.mean_reward(rolled), memory

    def update(self, xp, samples, returns, memory):
        """Return the mean of the best samples, equal weights for them, and their deviation."""
        count = max(2, round(self.elites * len(returns)))
        order = xp.argsort(returns, stable=True)
        best = samples[order[-count:]]
        weights = xp.where(xp.argsort(order) >= len(returns) - count, 1.0 / count, 0.0)
        return best.mean(axis=0), weights, {"deviation": xp.maximum(best.std(axis=0), self.least)}


class Predictive(sampling.Sampler):
    """Predictive sampling: the plan is the best sample."""

    title = "predictive sampling"
    # sigma is the best of 0.1 to 0.3 on seeds 10, 11 and 12
    defaults = sampling.Options(samples=512, sigma=0.2, node_factor=1.0, first_stages=1)

    def sample(self, xp, plan, noise, stage, memory):
        """Return perturbed plans."""
        return plan + stage.deviation * noise

    def returns(self, xp, rolled, memory):
        """Return the mean reward."""
        return self.mean_reward(rolled), memory

    def update(self, xp, samples, returns, memory):
        """Return the best sample, with weight 1 for it."""
        best = xp.argmax(returns)
        return samples[best], xp.where(xp.arange(len(returns)) == best, 1.0, 0.0), memory


controllers = {"cem": CEM, "predictive": Predictive}


def main(steps: int = 400, seeds: int = 3, engine: str = "auto") -> float:
    """Run both samplers with seeds 0, 1, ...; return the fraction of episodes in which the robot trots to the end."""
    successes = 0
    for name, kind in controllers.items():
        controller = kind(problem(), reward=reward, engine=engine)
        for seed in range(seeds):
            start = sampling.Spread().around(controller.model, controller.initial, seed)
            episode = sampling.run_episode(controller, steps=steps, seed=seed, initial=start)
            print(f"{name}, seed {seed}: {'success' if episode.success else 'failure'}, {episode.distance:.2f} m")
            successes += episode.success
    return successes / (seeds * len(controllers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--engine", default="auto", help="native, simd or mjx")
    print(f"success in {100 * main(**vars(parser.parse_args())):.0f} %")
