"""Checks of a horizon's inputs: measured states, commands, and models whose parts may have one mode."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError, ShapeError, UnknownNameError

from ..language import ModelBase, model_of
from .spans import SpanLayout
from .tables import Tables

Array = NDArray[np.float64]


def checked_state(model: ModelBase, x: ArrayLike) -> Array:
    """Return a measured state (nx,); raise if it has another size or is not finite."""
    state = np.asarray(x, dtype=float)
    space = model.state
    if state.shape != (space.nx,):
        raise ShapeError(
            f"horizon, model '{model.name}': state has the wrong size - got shape {state.shape}, expected "
            f"({space.nx},); give the state of this model"
        )
    if not np.all(np.isfinite(state)):
        bad = space.stored_labels[int(np.flatnonzero(~np.isfinite(state))[0])]
        raise ProblemError(
            f"horizon: state is not finite - got {state[~np.isfinite(state)][0]} in '{bad}', expected numbers; "
            "check the estimator"
        )
    return state


def checked_commands(known: Mapping[str, float], commands: Mapping[str, float]) -> dict[str, float]:
    """Return commands as numbers; raise for an unknown name or a value that is not finite."""
    for name, value in commands.items():
        if name not in known:
            raise UnknownNameError("horizon", "command", name, known)
        if not (isinstance(value, int | float | np.number) and np.isfinite(value)):
            raise ProblemError(f"horizon, command '{name}': is not finite - got {value!r}, expected a number; fix it")
    return {name: float(value) for name, value in commands.items()}


def refuse_modes_inside(layout: SpanLayout, tables: Tables) -> None:
    """Raise if a part of the horizon may contain modes with other dynamics than that at its start."""
    models = map(model_of, layout.schedule.segments)
    for model, cut, table in zip(models, layout.cut, tables.segments, strict=True):
        if not cut and len(keys := dict.fromkeys(tables.modes[i].lowered.key for i in table.mode)) > 1:
            raise ProblemError(
                f"horizon, model '{model.name}': has one phase for all modes and several dynamics - got "
                f"{', '.join(keys)}, expected one; return one key from mode_key, or set cut_by_modes"
            )
