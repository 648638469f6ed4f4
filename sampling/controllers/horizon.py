"""The receding horizon: its length, its initial state, and the shift of a plan in time."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import SamplingError, ShapeError
from piaffe.models import Mujoco
from piaffe.ocp import Problem, is_same_time, whole_steps

from .spline import Spline

Array = NDArray[np.float64]


def simulated(problem: Problem) -> Mujoco:
    """Return the MuJoCo model of a problem's schedule; raise SamplingError if the schedule has another model."""
    segment = problem.schedule.segments[0]
    if not isinstance(segment.model, Mujoco):
        raise SamplingError(
            f"schedule ({segment.source}): its model cannot be rolled out - got {type(segment.model).__name__} "
            f"'{segment.model.name}', expected models.Mujoco(robot); use one in the schedule"
        )
    return segment.model


def steps_of(problem: Problem, dt: float) -> int:
    """Return H of a problem's schedule; raise SamplingError if its duration is not fixed."""
    segment = problem.schedule.segments[0]
    if segment.duration is None:
        raise SamplingError(
            f"schedule ({segment.source}): has no horizon - got until_end, expected a duration; write "
            f"model.over(duration, dt={dt:g})"
        )
    return whole_steps(segment.duration, dt, f"schedule ({segment.source})")


def checked_state(x: ArrayLike, model: Mujoco) -> Array:
    """Return a state (nx,) as an array; raise an error if it has another size or is not finite."""
    start: Array = np.asarray(x, dtype=float)
    nx = model.state.nx
    if start.shape != (nx,):
        raise ShapeError(
            f"plan: state has the wrong size - got shape {start.shape}, expected ({nx},); build it with model.state()"
        )
    if not np.all(np.isfinite(start)):
        bad = np.flatnonzero(~np.isfinite(start)).tolist()
        raise SamplingError(
            f"plan: state is not finite - got NaN or infinity at entries {bad}, expected finite numbers; check "
            "the state estimate"
        )
    return start


def moved(spline: Spline, plan: Array, elapsed: float) -> Array:
    """Return a plan shifted by some steps, with the spline extrapolated beyond its end.

    If the shift is negative or longer than the plan, all nodes are the centre of the range.

    Args:
        spline: map from nodes to controls.
        plan: nodes (knots + 1, nu), scaled to [-1, 1].
        elapsed: number of steps, not always an integer.
    """
    if not 0 <= elapsed <= spline.steps + 1:
        return np.zeros_like(plan)
    at = np.linspace(0.0, spline.steps, spline.knots + 1) + elapsed
    return np.clip(spline.at(at) @ plan, -1.0, 1.0)


def moved_by_steps(spline: Spline, plan: Array, t: float, before: float, dt: float) -> Array:
    """Return a plan shifted by a whole number of steps; the new controls at its end are the centre of their range.

    Args:
        spline: map from nodes to controls.
        plan: nodes (knots + 1, nu), scaled to [-1, 1].
        t: current time [s].
        before: time of the plan [s].
        dt: duration of a step [s].

    Raises:
        SamplingError: the number of steps is not an integer, or is negative.
    """
    count = round((t - before) / dt)
    if count < 0 or not is_same_time(count * dt, t - before):
        raise SamplingError(
            f"plan at t = {t:g} s: is not a whole number of steps after the last one - got {t - before:g} s, expected "
            f"a multiple of {dt:g} s; call reset() first, or use shift='elapsed'"
        )
    controls = np.zeros((spline.steps + 1, plan.shape[1]))
    if count <= spline.steps:
        controls[: spline.steps + 1 - count] = (spline.to_controls @ plan)[count:]
    return np.clip(spline.to_nodes @ controls, -1.0, 1.0)


def centre_and_half_range(model: Mujoco) -> tuple[Array, Array]:
    """Return the centre and half of the range of the controls, (nu,) each; plans are scaled by them to [-1, 1]."""
    action = model.action
    return 0.5 * (action.upper + action.lower), 0.5 * (action.upper - action.lower)
