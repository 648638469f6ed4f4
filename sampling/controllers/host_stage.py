"""A stage of a plan in NumPy with an engine on the CPU, with the time of each part."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import NodeNumbers

from .contract import require_explained, require_sound, returned, sampled, settled, unexplained, updated
from .horizon import centre_and_half_range
from .stage import Memory, Rolled, Stage, Staged, Staging

Array = NDArray[np.float64]
Seconds = dict[str, float]


class HostStage:
    """Samples, roll-outs, evaluation and update, with an engine and an evaluator on the CPU.

    Args:
        controller: the controller; its methods are called with ``xp = numpy``. Its engine and value may be replaced.
    """

    def __init__(self, controller: Staging) -> None:
        self._controller = controller
        self._centre, self._half = centre_and_half_range(controller.model)
        self._ends = bool(controller.nodes.mode.rows["terminal_residual"])

    def __call__(
        self,
        start: Array,
        plan: Array,
        noise: Array,
        stage: Stage,
        memory: Memory,
        k: int,
        numbers: NodeNumbers,
        seconds: Seconds,
    ) -> Staged:
        """Return a stage's plan, roll-outs, weights and memory.

        Args:
            start: state (nx,).
            plan: the current plan, nodes (knots + 1, nu), scaled to [-1, 1].
            noise: standard normal numbers (N, knots + 1, nu), zero at node 0.
            stage: index and deviations of the stage.
            memory: memory of the sampler.
            k: index of the first node.
            numbers: parameters, weights and masks of nodes k … k + H.
            seconds: computing times by part; those of the stage are added to them.

        Raises:
            SamplingError: a method returns a wrong shape or NaN.
        """
        own = self._controller
        began = time.perf_counter()
        samples = sampled(own, np, plan, noise, stage, memory)
        controls = own.spline.controls(samples, self._centre, self._half)
        began = lap(seconds, "sample", began)
        rollouts = own.engine.rollout(start, controls)
        began = lap(seconds, "roll_out", began)
        cost, violation = own.evaluator.stage(
            rollouts.states[:, :-1], controls, numbers.p, numbers.weight, numbers.g_mask, numbers.h_mask
        )
        final = rollouts.states[:, -1]
        last = self._last(final, k + own.steps + 1)
        began = lap(seconds, "evaluate", began)
        value = None if own.value is None else own.value(final, k + own.steps + 1, own.nodes)
        rolled = Rolled(k, rollouts.states, controls, cost, last, value, violation, rollouts.failed)
        found, memory = returned(own, np, rolled, memory)
        returns, failed = settled(np, found, rolled.failed)
        if failed is not rolled.failed and not np.array_equal(failed, rolled.failed):
            require_explained(own, unexplained(np, found, rolled))
        began = lap(seconds, "value", began)
        plan, weights, memory = updated(own, np, samples, returns, memory)
        staged = Staged(plan, rolled._replace(failed=failed), returns, weights, memory)
        require_sound(own, staged)
        lap(seconds, "weigh", began)
        return staged

    def _last(self, states: Array, k: int) -> Array | None:
        """Return the cost of terms ``at="end"``, (n,); None if there are none."""
        if not self._ends:
            return None
        own = self._controller
        end = own.nodes.end(k)
        cost: Array = own.evaluator.terminal(states, end.p[0], end.weight[0], end.g_mask[0], end.h_mask[0])[0]
        return cost


def lap(seconds: Seconds, part: str, began: float) -> float:
    """Add the time since ``began`` to a part, and return the current time."""
    now = time.perf_counter()
    seconds[part] += now - began
    return now
