"""The planned velocity of a base, for plans that are played without a planner."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.models import base
from piaffe.ocp import SAME_TIME

from .tracking import heading, in_heading

Array = NDArray[np.float64]


def planned_velocity(plan: Any, times: Array) -> Array:
    """Return the velocity ahead and to the left [m/s], and the yaw rate [rad/s], of a plan at times (T,), (T, 3).

    Values are interpolated between the nodes; NaN if the plan has no phases with a base.

    Args:
        plan: its ``phases`` have ``times``, ``states`` and ``mode``, as ``solvers.PlanPhase``.
        times: (T,) [s].
    """
    found = np.full((len(times), 3), np.nan)
    for phase in getattr(plan, "phases", ()):
        where = phase.mode.state.slices
        if base.linear_velocity not in where or base.orientation not in where:
            return np.full((len(times), 3), np.nan)
        chosen = times >= phase.times[0] - SAME_TIME
        yaw = heading(phase.states[:, where[base.orientation]])
        rows = np.column_stack(
            [in_heading(yaw, phase.states[:, where[base.linear_velocity]]), _rates(yaw, phase.times)]
        )
        found[chosen] = np.column_stack([np.interp(times[chosen], phase.times, column) for column in rows.T])
    return found


def _rates(yaw: Array, times: Array) -> Array:
    return np.asarray(np.gradient(yaw, times))
