"""Episodes: the record of a controller and a plant in closed loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Episode:
    """The record of a closed loop, to its last step or to a fall.

    Args:
        times: times of the states (T + 1,) [s].
        states: states of the plant (T + 1, nx).
        actions: (T, nu).
        cost: running cost at every step (T,).
        reward: reward for the cost (T,).
        violation: violations of the rows of constraints (nc, T), divided by each row's scale.
        constraints: the constraint that each row belongs to, (nc,).
        steps: number of requested steps.
        fell: whether the robot fell.
        distance: horizontal distance in the direction of the commanded motion [m].
        commanded: the distance that the reference covers in the same time [m].
        plan_ms: time of every plan (T,) [ms].
        effective_samples: effective number of samples of every plan (T,); NaN if the controller does not report it.
        failed_rollouts: number of roll-outs with NaN in the episode.
    """

    times: Array
    states: Array
    actions: Array
    cost: Array
    reward: Array
    violation: Array
    constraints: tuple[str, ...]
    steps: int
    fell: bool
    distance: float
    commanded: float
    plan_ms: Array
    effective_samples: Array
    failed_rollouts: int

    @property
    def success(self) -> bool:
        """Whether the robot did not fall, and covered at least 0.8 of the commanded distance."""
        return not self.fell and self.distance >= 0.8 * self.commanded

    @property
    def speed_error(self) -> float:
        """Absolute difference between the mean speed and the commanded one [m/s]."""
        return abs(self.distance - self.commanded) / float(self.times[-1] - self.times[0])

    @cached_property
    def missed(self) -> Mapping[str, float]:
        """Violation of each constraint: the worst row at every step, then the mean over the steps."""
        names = np.array(self.constraints)
        return {
            name: float(self.violation[names == name].max(axis=0).mean()) for name in dict.fromkeys(self.constraints)
        }

    def summary(self) -> dict[str, Any]:
        """Return the figures of the episode, as values for JSON."""
        return {
            "success": self.success,
            "fell": self.fell,
            "steps": len(self.actions),
            "steps_asked": self.steps,
            "mean_reward": float(self.reward.sum() / self.steps),
            "mean_cost": float(self.cost.mean()),
            "missed_percent": {name: 100 * value for name, value in self.missed.items()},
            "distance_m": self.distance,
            "commanded_m": self.commanded,
            "speed_error_m_per_s": self.speed_error,
            "plan_ms_median": float(np.median(self.plan_ms)),
            "plan_ms_p95": float(np.percentile(self.plan_ms, 95)),
            "effective_samples_median": float(np.median(self.effective_samples)),
            "failed_rollouts": self.failed_rollouts,
        }
