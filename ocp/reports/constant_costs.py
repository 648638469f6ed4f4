"""Warnings about costs that no state and no control can change."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..compiler import CompiledPhase, CompiledProblem
from ..language import Cost, ProblemWarning

Array = NDArray[np.float64]

_SAMPLES = 3


def constant_costs(compiled: CompiledProblem) -> Iterator[ProblemWarning]:
    """Yield costs of which no row depends on state or control in any phase: they change nothing."""
    moving: set[int] = set()
    present: dict[int, None] = {}
    seen = set()
    for phase in compiled.phases:
        if phase.mode in seen:
            continue
        seen.add(phase.mode)
        for group in ("stage", "terminal"):
            rows = phase.mode.rows[f"{group}_residual"]
            if rows:
                changes = _changes(phase, group)
                present |= dict.fromkeys(row.term for row in rows)
                moving |= {row.term for row, changed in zip(rows, changes, strict=True) if changed}
    for term in present:
        declared = compiled.terms[term]
        if term not in moving and isinstance(declared, Cost):
            yield ProblemWarning(
                declared.where,
                "it depends on neither state nor control - got the same residual for different states, expected an "
                "expression of the node's quantities; correct it, or remove it",
                declared.source,
            )


def _changes(phase: CompiledPhase, group: str) -> NDArray[np.bool_]:
    """Return which rows of a group's residual differ between random points; what is not finite counts as different."""
    rng, mode = np.random.default_rng(0), phase.mode
    x, p = (phase.guess_states[0], phase.p[0]) if group == "stage" else (phase.guess_states[-1], phase.p_end)
    function = mode.functions[group]
    index = function.name_out().index("residual")
    values = []
    for _ in range(_SAMPLES):
        state = mode.state.np_plus(x, 0.3 * rng.standard_normal(mode.state.ndx))
        more = [rng.standard_normal(mode.nu), rng.standard_normal(mode.nz)] if group == "stage" else []
        values.append(function.call([state, *more, p])[index].full().ravel())
    table: Array = np.array(values)
    return np.asarray(np.any(table[1:] != table[0], axis=0))
