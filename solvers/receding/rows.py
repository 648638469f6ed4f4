"""What a tick keeps of the rows of the last plan: relaxations, shifts, multipliers and penalties."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import SAME_TIME, CompiledPhase, CompiledProblem, Span

from ..ilqr import PhaseDual
from .plan import Plan, PlannedPhase
from .shift import own_parts, times_in

Array = NDArray[np.float64]


def keep_rows(
    problem: CompiledProblem, spans: Sequence[Span], plan: Plan, duals: Sequence[PhaseDual], clock: float | None = None
) -> None:
    """Write the numbers of the last plan's rows where its nodes have the same rows; others stay as they are.

    The rows of a stage are those of the stage of the last plan that contains its time (or its middle, see
    ``ModelBase.acting``), in the same motion phase for a model with a phase per mode. The rows of a last node are those
    of the last node at the same time of the motion, and the rows of a transition those of the same kind of transition.

    Args:
        problem: the problem of the tick.
        spans: its parts.
        plan: the last plan, whose parts have rows.
        duals: what the tick's solve begins with, per phase.
        clock: see :func:`shifted`.
    """
    for i, (phase, span, dual) in enumerate(zip(problem.phases, spans, duals, strict=True)):
        own = own_parts(plan, phase, span)
        times = times_in(plan, phase, own, clock if i == 0 else None)
        half = phase.dt / 2 if phase.mode.model.acting else 0.0
        same = [part for part in own if part.mode is phase.mode]
        stored = dual.stored()
        for k, t in enumerate(times[:-1] + half):
            holds = [p for p in same if p.times[0] <= t + SAME_TIME and t < p.times[-1] - SAME_TIME]
            if holds:
                j = int(np.searchsorted(holds[-1].times, t + SAME_TIME, side="right")) - 1
                for name in _STAGE:
                    stored[name][k] = holds[-1].multipliers[name][j]
        end = phase.times[-1] + plan.shift
        ended = [part for part in same if abs(part.times[-1] - end) < SAME_TIME]
        if ended:
            _keep_end(phase, ended[-1], stored)


def _keep_end(phase: CompiledPhase, part: PlannedPhase, stored: Mapping[str, Array]) -> None:
    """Write the numbers of a last node's rows: the mode's, and the transition's if it is of the same kind."""
    for name in _END:
        kind = "h" if name in ("end_equality", "end_penalty") else "g"
        rows = slice(len(phase.mode.rows[f"terminal_{kind}"]))
        if part.transition is phase.transition:
            rows = slice(None)
        stored[name][rows] = part.multipliers[name][rows]


_STAGE = ("equality", "penalty", "relaxation", "shift")
_END = tuple(f"end_{name}" for name in _STAGE)
