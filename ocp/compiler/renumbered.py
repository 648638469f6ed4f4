"""Compiled phases with other values of their parameters."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from ..language import Constraint, Cost, ParameterKey
from .bounds import check_bounds
from .compiled_phase import CompiledPhase
from .parameters import tables
from .vectorised import Vectorised

Array = NDArray[np.float64]
Values = Mapping[ParameterKey, Array]


def renumbered(phase: CompiledPhase, terms: Sequence[Cost | Constraint], values: Values) -> CompiledPhase:
    """Return a phase with other values of some parameters.

    Args:
        phase: the phase.
        terms: the problem's terms.
        values: checked values (size,); values of other models are ignored.

    Raises:
        ProblemError: bounds exclude each other.
    """
    layouts = [phase.mode.layout, *([phase.transition.layout] if phase.transition is not None else [])]
    if not any(key in layout.slices for key in values for layout in layouts):
        return phase
    changed = replace(phase, p=phase.p.copy(), p_end=phase.p_end.copy(), p_transition=phase.p_transition.copy())
    for layout, table, applies in tables(changed):
        for key, value in values.items():
            part = layout.slices.get(key)
            if part is None:
                continue
            if key.kind in ("weight", "target"):
                table[applies[:, key.term], part] = value
            elif key.is_bound:
                table[:, part] = np.where(np.isfinite(value), value, 0.0)
                table[:, layout.slices[key.has_bound]] = np.isfinite(value)
            else:
                table[:, part] = value
    if any(key.is_bound for key in values):
        check_bounds(phase.mode, terms, changed.p)
        if phase.transition is not None:
            check_bounds(phase.transition, terms, changed.p_transition[None])
    weight, g_mask, h_mask = _evaluate(phase.mode.functions["stage_w"], changed.p)
    end = _evaluate(phase.mode.functions["terminal_w"], changed.p_end[None])
    if phase.transition is not None:
        rows = _evaluate(phase.transition.functions["rows_w"], changed.p_transition[None])
        end = [np.concatenate(both, axis=1) for both in zip(end, rows, strict=True)]
    return replace(
        changed, weight=weight, g_mask=g_mask, h_mask=h_mask, end_weight=end[0][0], end_g_mask=end[1][0],
        end_h_mask=end[2][0],
    )  # fmt: skip


def _evaluate(function: cs.Function, p: Array) -> list[Array]:
    """Return weights and masks; each thread has its own functions, because a function has its own buffers."""
    if not hasattr(_PER_THREAD, "functions"):
        _PER_THREAD.functions = lru_cache(maxsize=64)(Vectorised)
    results: list[Array] = _PER_THREAD.functions(function)(p)
    return results


_PER_THREAD = threading.local()
