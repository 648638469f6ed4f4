"""Warnings about parameters of constraints that are far larger than such numbers usually are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..compiler import CompiledProblem
from ..language import Constraint, ParameterKey, ProblemWarning


def large_parameters(compiled: CompiledProblem) -> Iterator[ProblemWarning]:
    """Yield parameters that are larger than usual: angles or per cent in place of a coefficient."""
    for k, term in enumerate(compiled.terms):
        for name, (most, advice) in term.usual.items() if isinstance(term, Constraint) else ():
            key = ParameterKey("parameter", name, term=k)
            parts = ((phase.p, phase.mode.layout.slices.get(key)) for phase in compiled.phases)
            got = max((float(np.max(p[:, part])) for p, part in parts if part is not None), default=0.0)
            if got > most:
                yield ProblemWarning(
                    term.where,
                    f"parameter '{name}' is larger than such numbers are - got {got:g}, expected at most {most:g}; "
                    f"{advice}",
                    term.source,
                )
