"""Check that the numbers of a compiled problem are finite, and its masks 0 or 1; errors name the declaration."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError

from ..language import ParameterKey, initial_state
from .compiled import CompiledProblem
from .compiled_phase import CompiledPhase
from .layout import Layout
from .mode import Row

Array = NDArray[np.float64]


def check_numbers(compiled: CompiledProblem) -> None:
    """Raise if a number of a compiled problem is NaN or infinite; name its declaration, the node and the entry.

    Raises:
        ProblemError: a parameter, weight, target, bound, time, initial state or guess is not finite, or a constraint's
            mask neither 0 nor 1.
    """
    initial_state(compiled.phases[0].mode.model, compiled.initial, "compiled problem")
    for i, phase in enumerate(compiled.phases):
        for where, layout, first, table in _parameters(phase):
            if np.all(np.isfinite(table)):
                continue
            node, entry = (int(k) for k in np.argwhere(~np.isfinite(table))[0])
            key = next(key for key, part in layout.slices.items() if part.start <= entry < part.stop)
            place = f"phase '{phase.name}', {f'node {first + node}' if first >= 0 else 'reset'}"
            raise _error(
                f"{_declared(compiled, key, where)}, {place}", entry - layout.slices[key].start, table[node, entry]
            )
        for what, first, array, rows in _tables(phase):
            fits = (array == 0.0) | (array == 1.0) if what == "mask" else np.isfinite(array)
            if np.all(fits):
                continue
            node, entry = (int(k) for k in np.argwhere(~fits)[0])
            owner = f"term '{compiled.row_name(rows[entry])}' ({_source(compiled, rows[entry])}), " if rows else ""
            name = f"{owner}phase {i} '{phase.name}' ({phase.interval.phase.source}), node {first + node}: {what}"
            if what == "mask" and np.isfinite(array[node, entry]):
                raise ProblemError(
                    f"{name} is invalid - got {array[node, entry]} at entry {entry}, expected 0 or 1; scale the rows "
                    "of the constraint instead"
                )
            raise _error(name, entry, array[node, entry])


def _declared(compiled: CompiledProblem, key: ParameterKey, model: str) -> str:
    """Return the declaration of a part of a parameter vector, with file and line."""
    if key.term is not None:
        return f"{compiled.terms[key.term].where}: {key.name or key.kind}"
    if key.kind == "parameter":
        return f"parameter '{key.name}'"
    return f"model '{model}', number '{key.name}'" if key.kind == "slot" else f"model '{model}', time step dt"


def _parameters(phase: CompiledPhase) -> Iterator[tuple[str, Layout, int, Array]]:
    """Yield model, layout, first node (-1 for a reset) and table of every parameter vector."""
    yield phase.mode.model.name, phase.mode.layout, 0, phase.p
    yield phase.mode.model.name, phase.mode.layout, phase.num_stages, phase.p_end[None]
    if phase.transition is not None:
        yield phase.mode.model.name, phase.transition.layout, -1, phase.p_transition[None]


def _tables(phase: CompiledPhase) -> Iterator[tuple[str, int, Array, tuple[Row, ...]]]:
    """Yield kind, first node, table and the rows of its columns, for all other numbers."""
    n, rows, end_rows = phase.num_stages, phase.mode.rows, phase.end_rows
    yield "weight", 0, phase.weight, rows["stage_residual"]
    yield "mask", 0, phase.g_mask, rows["stage_g"]
    yield "mask", 0, phase.h_mask, rows["stage_h"]
    yield "weight", n, phase.end_weight[None], end_rows("residual")
    yield "mask", n, phase.end_g_mask[None], end_rows("g")
    yield "mask", n, phase.end_h_mask[None], end_rows("h")
    yield "time step", 0, np.array([[phase.dt]]), ()
    yield "time", 0, phase.times[:, None], ()
    yield "initial guess of the states", 0, phase.guess_states, ()
    yield "initial guess of the controls", 0, phase.guess_controls, ()


def _source(compiled: CompiledProblem, row: Row) -> str:
    return str(compiled.terms[row.term].source) if row.term >= 0 else "derived from the contact sequence"


def _error(where: str, entry: int, got: float) -> ProblemError:
    return ProblemError(f"{where} is not finite - got {got} at entry {entry}, expected finite numbers; fix it")
