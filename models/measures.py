"""Measures of a motion: rotation of the base, apex of the base, smallest height of the feet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import CompiledProblem, Trajectory, quantity_values, rotation

from .quantities import base, feet

Array = NDArray[np.float64]


def series(trajectory: Trajectory, path: str) -> Array | None:
    """Return a quantity of the state at all nodes of the phases that have it, (nodes, size); None if none has it."""
    parts = []
    for phase in trajectory.phases:
        for quantity, where in phase.state.slices.items():
            if quantity.path == path:
                parts.append(phase.states[:, where])
    return np.concatenate(parts) if parts else None


def turns(trajectory: Trajectory) -> Array | None:
    """Return the sum of the base's rotation vectors from node to node, in its own axes, (3,) [rad]."""
    orientations = series(trajectory, base.orientation.path)
    if orientations is None:
        return None
    steps = rotation.np_multiply(rotation.np_conjugate(orientations[:-1]), orientations[1:])
    return np.asarray(np.sum(rotation.np_log(steps), axis=0))


def apex(trajectory: Trajectory) -> float | None:
    """Return the largest height of the base's origin [m]."""
    positions = series(trajectory, base.position.path)
    return None if positions is None else float(positions[:, 2].max())


def lowest_foot(compiled: CompiledProblem, trajectory: Trajectory) -> float | None:
    """Return the smallest gap between a foot's ball and the terrain [m], over the phases whose model has legs."""
    heights = [values for values in quantity_values(compiled, trajectory, feet.height) if values is not None]
    return float(min(values.min() for values in heights)) if heights else None
