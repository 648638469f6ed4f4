"""Two samplers of one's own, the cross-entropy method and predictive sampling: Solo12 trots with both, on any engine."""

import argparse

import numpy as np
import trot_mppi

from piaffe import sampling

problem = sampled_problem = trot_mppi.sampled_problem
reward = trot_mppi.reward


class CEM(sampling.Sampler):
    """Cross-entropy method: the mean of the best samples; their spread is what the next stage samples with."""

    title = "CEM"
    defaults = sampling.Options(samples=256, sigma=0.5, node_factor=0.9, stages=2, first_stages=6)
    elites, least = 0.1, 0.05  # share of the samples; least deviation, in halves of the controls' range

    def initial_memory(self):
        return {"deviation": np.full((self.options.knots + 1, len(self.model.action.centre)), self.options.sigma)}

    def sample(self, xp, plan, noise, stage, memory):
        return plan + xp.where(stage.index == 0, stage.deviation, memory["deviation"]) * noise

    def returns(self, xp, rolled, memory):
        return self.mean_reward(rolled), memory

    def update(self, xp, samples, returns, memory):
        count = max(2, round(self.elites * len(returns)))
        order = xp.argsort(returns, stable=True)
        best = samples[order[-count:]]
        weights = xp.where(xp.argsort(order) >= len(returns) - count, 1.0 / count, 0.0)
        return best.mean(axis=0), weights, {"deviation": xp.maximum(best.std(axis=0), self.least)}


class Predictive(sampling.Sampler):
    """Predictive sampling: the best of the samples is the plan."""

    title = "predictive sampling"
    defaults = sampling.Options(samples=512, sigma=0.2, node_factor=1.0, first_stages=1)

    def sample(self, xp, plan, noise, stage, memory):
        return plan + stage.deviation * noise

    def returns(self, xp, rolled, memory):
        return self.mean_reward(rolled), memory

    def update(self, xp, samples, returns, memory):
        best = xp.argmax(returns)
        return samples[best], xp.where(xp.arange(len(returns)) == best, 1.0, 0.0), memory


controllers = {"cem": CEM, "predictive": Predictive}
