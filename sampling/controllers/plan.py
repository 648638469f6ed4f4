"""The plan that a sampling controller returns at every step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .stage import Staged

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan from a state, and the roll-outs of its last stage.

    Args:
        time: start of the plan, since the motion's start [s].
        action: the control to apply now, (nu,), in the model's units.
        controls: planned controls at steps 0 … H, (H + 1, nu), in the model's units.
        weights: weights of the roll-outs, (n,); the last one is that of the unperturbed plan.
        returns: returns of the roll-outs, (n,).
        effective_samples: 1 / Σ w².
        failed: number of failed roll-outs.
        states: states of the roll-outs, (n, H + 2, nx). The next plan overwrites them; copy them to keep them.
        cost: running cost of the roll-outs, (n, H + 1); the next plan overwrites it, too.
        violation: violations of the rows of constraints, (nc, n, H + 1); the next plan overwrites them, too.
        missed: violation of each constraint's worst row in a step: mean over steps, weighted mean over roll-outs.
        seconds: computing times of this plan by part: ``sample``, ``roll_out``, ``evaluate``, ``value``, ``weigh`` [s].
    """

    time: float
    action: Array
    controls: Array
    weights: Array
    returns: Array
    effective_samples: float
    failed: int
    states: Array
    cost: Array
    violation: Array
    missed: Mapping[str, float]
    seconds: Mapping[str, float]

    @property
    def figures(self) -> Mapping[str, float]:
        """Number of effective samples and of failed roll-outs."""
        return {"effective_samples": self.effective_samples, "failed": self.failed}


def report(t: float, staged: Staged, controls: Array, constraints: Sequence[str], seconds: Mapping[str, float]) -> Plan:
    """Return the plan of a last stage.

    Args:
        t: when it begins, since the motion's start [s].
        staged: the stage.
        controls: of its plan, (H + 1, nu), in the model's units.
        constraints: the constraint that each row of a violation belongs to, (nc,).
        seconds: how long the parts of the plan took.
    """
    rolled, weights = staged.rolled, staged.weights
    names, rows = np.array(constraints), rolled.violation.transpose(0, 2, 1)  # as they lie in memory
    # the violation of each constraint's worst row: mean over steps, weighted mean over samples
    missed = {name: float(np.mean(rows[names == name].max(axis=0) @ weights)) for name in dict.fromkeys(constraints)}
    return Plan(
        time=t,
        action=controls[0],
        controls=controls,
        weights=weights,
        returns=staged.returns,
        effective_samples=float(1.0 / np.sum(weights**2)),
        failed=int(rolled.failed.sum()),
        states=rolled.states,
        cost=rolled.cost,
        violation=rolled.violation,
        missed=missed,
        seconds=dict(seconds),
    )
