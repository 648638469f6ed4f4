"""The columns of a trajectory as a table: one row per node, one column per component of a quantity."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .manifold import Manifold
from .phase_trajectory import PhaseTrajectory
from .quantity import Quantity

TIME = "time [s]"
KEYS = ("phase", "mode", "model", "ends_phase")
Columns = dict[str, NDArray[Any]]


def column_name(quantity: Quantity, label: str) -> str:
    """Return ``"base.position x [m]"``; the components of a quaternion have no unit."""
    unit = "" if quantity.kind == "rotation" or not quantity.unit else f" [{quantity.unit}]"
    return f"{quantity} {label}".strip() + unit


def names_of(space: Manifold) -> list[str]:
    """Return the names of the columns of a state or control, one per stored component."""
    names = []
    for block in space.blocks:
        labels = ("w", "x", "y", "z") if block.quantity.kind == "rotation" else block.labels
        names += [column_name(block.quantity, label) for label in labels]
    return names


def columns_of(phases: Sequence[PhaseTrajectory]) -> Columns:
    """Return the columns of a trajectory by name.

    A phase of N stages has N + 1 rows; controls and outputs are NaN in its last row, where the phase has none. There,
    and only there, are the outputs of a reset. Columns that a model does not have are NaN too. So the end of a phase
    and the start of the next one are two rows with the same time.
    """
    parts = [_rows(part) for part in phases]
    names = list(dict.fromkeys(name for part in parts for name in part))
    sizes = [len(part[TIME]) for part in parts]
    blank = [np.full(size, np.nan) for size in sizes]
    return {
        name: np.concatenate([part.get(name, empty) for part, empty in zip(parts, blank, strict=True)])
        for name in names
    }


def _rows(part: PhaseTrajectory) -> Columns:
    count = len(part.times)
    found: Columns = {TIME: part.times}
    for key, value in zip(KEYS, (part.name, part.mode, part.model, part.ends_phase), strict=True):
        found[key] = np.full(count, value)
    for name, column in zip(names_of(part.state), part.states.T, strict=True):
        found[name] = column
    for name, column in zip(names_of(part.control), part.controls.T, strict=True):
        found[name] = np.append(column, np.nan)
    for name, column in _outputs(part):
        found[name] = column
    return found


def _outputs(part: PhaseTrajectory) -> Iterator[tuple[str, NDArray[np.float64]]]:
    for quantity, values in part.outputs.items():
        for label, column in zip(labels_of(part, quantity, values.shape[1]), values.T, strict=True):
            yield column_name(quantity, label), np.append(column, np.nan)
    for quantity, ended in part.reset_outputs.items():
        for label, value in zip(labels_of(part, quantity, ended.size), ended, strict=True):
            yield column_name(quantity, label), np.append(np.full(len(part.times) - 1, np.nan), value)


def labels_of(part: PhaseTrajectory, quantity: Quantity, size: int) -> tuple[str, ...]:
    """Return one label per component of an output; numbers if the trajectory does not know them."""
    return part.output_labels.get(quantity, tuple(str(i) for i in range(size)))
