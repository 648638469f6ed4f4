"""What a sampling controller returns at every step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan from a state, and the roll-outs of its last stage.

    Args:
        time: when it begins, since the motion's start [s].
        action: the control to apply now, (nu,), in the model's units.
        controls: what it means to apply at steps 0 … H, (H + 1, nu).
        weights: of the roll-outs, (n,); the unperturbed plan's is the last one.
        returns: of the roll-outs, (n,).
        effective_samples: 1 / Σ w².
        failed: how many roll-outs ended in NaN.
        states: of the roll-outs, (n, H + 2, nx). They are overwritten by the next plan; copy what is to be kept.
        cost: running cost of the roll-outs, (n, H + 1); overwritten likewise.
        violation: violations of the rows of constraints, (nc, n, H + 1); overwritten likewise.
        missed: mean violation of each constraint over roll-outs (by weight) and steps, of its worst row in each.
        seconds: how long the parts of this plan took: ``sample``, ``roll_out``, ``evaluate``, ``value``, ``weigh``.
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
        """Effective samples and failed roll-outs."""
        return {"effective_samples": self.effective_samples, "failed": self.failed}
