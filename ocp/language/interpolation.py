"""A trajectory between its nodes: the phase and the stage at a time, and states in between."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .time import SAME_TIME
from .trajectory import PhaseTrajectory, Trajectory

Array = NDArray[np.float64]


def phase_index(trajectory: Trajectory, t: float) -> int:
    """Return the phase at time t [s]; the later one on a boundary, the first one before the start."""
    return max((i for i, part in enumerate(trajectory.phases) if part.times[0] <= t + SAME_TIME), default=0)


def node_before(part: PhaseTrajectory, t: float) -> tuple[int, float]:
    """Return the stage that contains time t [s], and the elapsed fraction of it; clamped to the phase."""
    k = int(np.clip(np.searchsorted(part.times, t + SAME_TIME, side="right") - 1, 0, len(part.times) - 2))
    return k, float(np.clip((t - part.times[k]) / (part.times[k + 1] - part.times[k]), 0.0, 1.0))


def interpolate(part: PhaseTrajectory, states: Array, t: float) -> Array:
    """Return a state between nodes, (nx,).

    Args:
        part: the phase, which has the times of the nodes and the manifold of the states.
        states: states at its nodes (N + 1, nx): its own, or others, for example the targets.
        t: time [s], clamped to the phase.
    """
    k, share = node_before(part, t)
    return part.state.np_plus(states[k], share * part.state.np_minus(states[k + 1], states[k]))
