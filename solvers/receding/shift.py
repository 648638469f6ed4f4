"""The first iterate of a tick: the last plan, shifted in time, and the path where it has no node."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import SAME_TIME, CompiledPhase, CompiledProblem, Manifold, PlanarFrame, Span, transform_state

from .plan import Plan, PlannedPhase

Array = NDArray[np.float64]


def shifted(
    problem: CompiledProblem,
    spans: Sequence[Span],
    plan: Plan | None,
    moved: PlanarFrame,
    x: Array,
    clock: float | None = None,
) -> tuple[list[Array], list[Array], list[bool]]:
    """Return states and controls of the first iterate, and per phase whether the last plan had nothing of it.

    A node gets the state of the last plan at its time: in the same motion phase for a model with a phase per mode, in
    any phase of the same model for others. A stage gets the control of the stage of the last plan that contains its
    time (or its middle, see ``ModelBase.acting``), or in the same motion phase the last one. What is left has the guess
    of the problem.

    Args:
        problem: the problem of the tick.
        spans: its parts.
        plan: the last plan; None for the first.
        moved: planar motion from the last plan's frame to this one's.
        x: initial state in the plan's frame (nx,).
        clock: time by which the motion is now later than declared [s], if that has just changed. The phase at the
            present then takes what the last plan has at the same time of the world, the nearest within the phase.
    """
    states = [phase.guess_states.copy() for phase in problem.phases]
    controls = [phase.guess_controls.copy() for phase in problem.phases]
    fresh = []
    for phase, span, xs, us in zip(problem.phases, spans, states, controls, strict=True):
        space, cut = phase.mode.state, phase.mode.model.cut_by_modes
        own = own_parts(plan, phase, span)
        fresh.append(not own)
        times = times_in(plan, phase, own, clock if phase is problem.phases[0] else None)
        for k, t in enumerate(times):
            part = _containing(own, float(t))
            if part is not None:
                xs[k] = transform_state(space, _state(part, float(t), space), moved)
        for k, start in enumerate(times[:-1]):
            t = start + phase.dt / 2 if phase.mode.model.acting else start
            before = [part for part in own if part.times[0] <= t + SAME_TIME]
            if before:
                part = before[-1]
                j = int(np.searchsorted(part.times, t + SAME_TIME, side="right")) - 1
                if cut or j < len(part.controls):
                    control = part.controls[min(j, len(part.controls) - 1)]
                    us[k] = transform_state(phase.mode.model.control, control, moved)
    states[0][0] = x
    return states, controls, fresh


def own_parts(plan: Plan | None, phase: CompiledPhase, span: Span) -> list[PlannedPhase]:
    """Return the phases of a plan that a phase of the next tick goes on from: of its model, and perhaps its number."""
    space, cut = phase.mode.state, phase.mode.model.cut_by_modes
    return [
        part
        for part in (() if plan is None else plan.parts)
        if part.mode.state is space and (part.number == span.place.number or not cut)
    ]


def times_in(plan: Plan | None, phase: CompiledPhase, own: Sequence[PlannedPhase], clock: float | None) -> Array:
    """Return the times of the last plan at which nodes of a phase (N+1,) find what they take from it [s]."""
    if clock is not None and own:
        return np.clip(phase.times + clock, own[0].times[0], own[0].times[-1])
    return phase.times + (0.0 if plan is None else plan.shift)


def _containing(parts: Sequence[PlannedPhase], t: float) -> PlannedPhase | None:
    """Return the last of some phases that contains a time, its ends included."""
    inside = [part for part in parts if part.times[0] <= t + SAME_TIME and t <= part.times[-1] + SAME_TIME]
    return inside[-1] if inside else None


def _state(part: PlannedPhase, t: float, space: Manifold) -> Array:
    """Return the state of a phase at a time, interpolated between nodes."""
    k = int(np.clip(np.searchsorted(part.times, t + SAME_TIME, side="right") - 1, 0, len(part.times) - 2))
    share = float(np.clip((t - part.times[k]) / (part.times[k + 1] - part.times[k]), 0.0, 1.0))
    if share < SAME_TIME or share > 1 - SAME_TIME:
        return np.asarray(part.states[k if share < 0.5 else k + 1])
    return np.asarray(space.np_plus(part.states[k], share * space.np_minus(part.states[k + 1], part.states[k])))
