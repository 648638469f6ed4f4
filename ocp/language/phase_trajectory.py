"""One phase of a trajectory: states, controls and outputs at its nodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .manifold import Manifold
from .quantity import Quantity
from .time import SAME_TIME

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class PhaseTrajectory:
    """One phase of one model.

    Args:
        name: the motion phase's name.
        mode: its mode as text, e.g. ``"FL HR"``.
        model: the model's name.
        times: node times (N+1,) [s].
        states: (N+1, nx).
        controls: (N, nu).
        outputs: quantity → (N, size), e.g. contact forces.
        state: layout of the states.
        control: layout of the controls.
        ends_phase: whether the motion's phase ends at the last node; if not, the segment or the horizon ends there.
        reset_outputs: quantity → (size,), e.g. the impulses of the feet in the impact after the last node; empty if
            there is no impact.
        output_labels: quantity → one label per component of an output, e.g. ``"FL x"``; empty if they are not known.
    """

    name: str
    mode: str
    model: str
    times: Array
    states: Array
    controls: Array
    outputs: Mapping[Quantity, Array]
    state: Manifold
    control: Manifold
    ends_phase: bool = True
    reset_outputs: Mapping[Quantity, Array] = field(default_factory=dict)
    output_labels: Mapping[Quantity, tuple[str, ...]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return (
            f"PhaseTrajectory('{self.name}' of '{self.model}', {self.times[0]:g} to {self.times[-1]:g} s, "
            f"states {self.states.shape}, controls {self.controls.shape})"
        )

    @property
    def duration(self) -> float:
        """Length [s]."""
        return float(self.times[-1] - self.times[0])

    def sample(self, t: float) -> dict[Quantity, Array]:
        """Return state (interpolated on the manifold), control and outputs (held) at time t, clamped to the phase."""
        t = float(np.clip(t, self.times[0], self.times[-1]))
        i = int(np.clip(np.searchsorted(self.times, t + SAME_TIME, side="right") - 1, 0, len(self.times) - 2))
        share = float(np.clip((t - self.times[i]) / (self.times[i + 1] - self.times[i]), 0.0, 1.0))
        x0, x1 = self.states[i], self.states[i + 1]
        sample = self.state.unpack(self.state.np_plus(x0, share * self.state.np_minus(x1, x0)))
        sample.update(self.control.unpack(self.controls[i]))
        sample.update({quantity: values[i] for quantity, values in self.outputs.items()})
        return sample
