"""Warnings about the time grid: too many nodes, and phases of few steps."""

from __future__ import annotations

from collections.abc import Iterator

from ..compiler import CompiledProblem
from ..language import Problem, ProblemWarning

MANY_NODES = 10_000
"""A horizon of more nodes is reported: durations in milliseconds are the usual cause."""
FEW_STEPS = 3
"""A phase of fewer steps is reported: a Euler step is too coarse for it."""


def early_warnings(problem: Problem) -> list[ProblemWarning]:
    """Return the warnings that need no compilation, so that they come before a compilation that takes long."""
    total, reached = problem.motion.duration, 0.0
    count, steps = 0.0, ""
    for segment in problem.schedule.segments:
        length = max(total - reached, 0.0) if segment.duration is None else segment.duration
        count, reached = count + length / segment.dt, reached + length
        steps += f"{', ' if steps else ''}{length:g} s in steps of {segment.dt:g} s"
    if not MANY_NODES < count < float("inf"):
        return []
    source = problem.schedule.segments[0].source
    return [
        ProblemWarning(
            f"schedule ({source})",
            f"the horizon has very many nodes - got {count:.0f}: {steps}, expected at most {MANY_NODES}; give "
            "durations in seconds, a larger dt, or a shorter motion",
            source,
        )
    ]


def few_steps(compiled: CompiledProblem) -> Iterator[ProblemWarning]:
    """Yield the phases of the motion that have few steps."""
    seen = set()
    for phase in compiled.phases:
        declared = phase.interval.phase
        steps = round(declared.duration / phase.dt)
        if phase.mode.model.cut_by_modes and steps < FEW_STEPS and declared not in seen:
            seen.add(declared)
            yield ProblemWarning(
                f"phase '{declared.name}' ({declared.source})",
                f"the phase has few steps - got {steps} of {phase.dt:g} s in {declared.duration:g} s, expected at "
                f"least {FEW_STEPS}; give a smaller dt to the schedule, or a longer duration",
                declared.source,
            )
