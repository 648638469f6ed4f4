"""Warnings about arrays of targets that end before their motion does."""

from __future__ import annotations

from collections.abc import Iterator

from ..compiler import CompiledProblem
from ..language import SAME_TIME, FromArrays, ProblemWarning


def short_references(compiled: CompiledProblem) -> Iterator[ProblemWarning]:
    """Yield references of arrays that end before their phases, or begin after them: the nearest row is held there."""
    for piece in compiled.path.pieces:
        reference = piece.reference
        if not isinstance(reference, FromArrays) or piece.cycle:
            continue
        length = sum(phase.duration for phase in piece.phases)
        first, last = float(reference.times[0]), float(reference.times[-1])
        if first > SAME_TIME or last < length - SAME_TIME:
            yield ProblemWarning(
                f"FromArrays ({reference.source})",
                f"the times do not cover the motion - got {first:g} s to {last:g} s, expected 0 s to {length:g} s, the "
                "end of its phases; the nearest row is held elsewhere: add rows, give seconds, or change the durations",
                reference.source,
            )
