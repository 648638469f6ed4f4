"""Model predictive path integral control: perturb a plan, roll out, and compute a weighted mean."""

from __future__ import annotations

from typing import Any, ClassVar

from ..namespace import namespace
from ..options import Options
from .base import Sampler
from .stage import Memory, Rolled, Stage

_SPREAD = 1e-6  # least standard deviation of returns, so that equal returns get equal weights


class MPPI(Sampler):
    """MPPI: the plan is the weighted mean of the samples; :class:`Sampler` describes the spline and the stages.

    1. The samples are the plan with perturbations of all nodes except the first, by the schedule of ``Options.noise``.
    2. R_n is the mean reward of roll-out n.
    3. plan ← Σ w_n samples_n with w = softmax((R − R_best) / (λ std R)).
    """

    title: ClassVar[str] = "MPPI"
    defaults: ClassVar[Options] = Options(stage_factor=1.0, node_factor=1.0, first_stages=1)

    def sample(self, xp: Any, plan: Any, noise: Any, stage: Stage, memory: Memory) -> Any:
        """Return perturbed plans, (N, knots + 1, nu)."""
        return noise * stage.deviation + plan

    def returns(self, xp: Any, rolled: Rolled, memory: Memory) -> tuple[Any, Memory]:
        """Return the mean reward of every roll-out, (n,)."""
        return self.mean_reward(rolled), memory

    def update(self, xp: Any, samples: Any, returns: Any, memory: Memory) -> tuple[Any, Any, Memory]:
        """Return the weighted mean of the samples, the weights, and the memory."""
        weights = softmax(returns, self.options.temperature)
        plan = xp.einsum("n,ni->i", weights, samples.reshape(len(samples), -1)).reshape(samples.shape[1:])
        return plan, weights, memory


def softmax(returns: Any, temperature: float) -> Any:
    """Return weights exp((R − R_best) / (λ std R)) with the sum one, (n,); equal returns get equal weights."""
    xp = namespace(returns)
    spread = xp.maximum(xp.std(returns), _SPREAD)
    weights = xp.exp((returns - xp.max(returns)) / (temperature * spread))
    return weights / weights.sum()
