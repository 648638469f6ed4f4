"""Transitions: the data of TD(0), with the inputs of the network."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SamplingError, ShapeError

Array = NDArray[np.float64]

NEGLIGIBLE = 0.1  # largest weight of the return after an episode's end at which a return counts as known


@dataclass(frozen=True, eq=False)
class Transitions:
    """T transitions of E episodes, in order of episode and time.

    Args:
        inputs: inputs of the states, (T, m).
        next_inputs: inputs of the next states, (T, m).
        rewards: (T,), not negative.
        delta: δ of the constraints, (T,) in [0, 1].
        done: whether the next state is a fall, (T,); then its value is 0.
        episode: number of the episode, (T,).
    """

    inputs: Array
    next_inputs: Array
    rewards: Array
    delta: Array
    done: NDArray[np.bool_]
    episode: NDArray[np.int64]

    def __post_init__(self) -> None:
        count = len(self.inputs)
        for name in ("next_inputs", "rewards", "delta", "done", "episode"):
            if len(getattr(self, name)) != count:
                raise ShapeError(
                    f"transitions, '{name}': wrong number of rows - got {len(getattr(self, name))}, expected {count}; "
                    "give one per transition"
                )
        if count == 0:
            raise SamplingError("transitions: there are none - got 0, expected at least one; make a larger dataset")
        for name in ("inputs", "next_inputs", "rewards", "delta"):
            bad = ~np.isfinite(getattr(self, name))
            if bad.any():
                raise SamplingError(
                    f"transitions, '{name}': not finite - got NaN or infinity in row {int(np.argwhere(bad)[0][0])}, "
                    "expected finite numbers; leave that transition out"
                )
        if self.rewards.min() < 0 or self.delta.min() < 0 or self.delta.max() > 1:
            raise SamplingError(
                f"transitions: out of range - got rewards from {self.rewards.min():g} and discounts from "
                f"{self.delta.min():g} to {self.delta.max():g}, expected rewards ≥ 0 and discounts in [0, 1]; use "
                "sampling.Reward"
            )

    def __len__(self) -> int:
        return len(self.rewards)

    def take(self, rows: NDArray[np.bool_]) -> Transitions:
        """Return the transitions that a mask (T,) selects."""
        return Transitions(**{name: values[rows] for name, values in vars(self).items()})

    def split(self, held_out: float, seed: int) -> tuple[Transitions, Transitions | None]:
        """Return the transitions to learn from and whole episodes to test with; None if there are none."""
        episodes = np.unique(self.episode)
        count = min(round(held_out * len(episodes)), len(episodes) - 1)
        if count == 0:
            return self, None
        chosen = np.isin(self.episode, np.random.default_rng(seed).permutation(episodes)[:count])
        return self.take(~chosen), self.take(chosen)

    def returns(self, discount: float) -> tuple[Array, Array]:
        """Return the discounted sum of rewards to the episode's end, and the weight of the return after it, (T,) each.

        The sum is ``G_t = γ₀ (1 − δ_t) (r_t + G_{t+1})``; the weight is 0 if the episode ended in a fall.
        """
        total, weight = np.zeros(len(self)), np.zeros(len(self))
        gamma = discount * (1.0 - self.delta)
        for t in range(len(self) - 1, -1, -1):
            goes_on = t + 1 < len(self) and self.episode[t + 1] == self.episode[t]
            after, beyond = (total[t + 1], weight[t + 1]) if goes_on else (0.0, float(not self.done[t]))
            total[t], weight[t] = gamma[t] * (self.rewards[t] + after), gamma[t] * beyond
        return total, weight
