"""Trajectories as CSV files: of solutions, and of motion capture and other planners."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import FileFormatError
from piaffe.files import write_whole

from .columns import KEYS, TIME, columns_of, names_of
from .manifold import Manifold
from .model import ModelBase
from .phase_trajectory import PhaseTrajectory
from .quantity import Quantity
from .time import SAME_TIME

Array = NDArray[np.float64]


def write_csv(phases: Sequence[PhaseTrajectory], path: Path) -> Path:
    """Write a trajectory as CSV, see :meth:`Trajectory.to_csv`."""
    columns = columns_of(phases)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*(column.tolist() for column in columns.values()), strict=True):
        writer.writerow(["" if value != value else value for value in row])  # a missing number is an empty field
    write_whole(path, text.getvalue().encode())
    return path


def read_csv(path: Path, models: Sequence[ModelBase]) -> tuple[PhaseTrajectory, ...]:
    """Read a trajectory from CSV, see :meth:`Trajectory.from_csv`."""
    names, rows = _table(path)
    columns = {name: [row[i] for row in rows] for i, name in enumerate(names)}
    if TIME not in columns:
        raise FileFormatError(
            f"trajectory '{path}': has no column '{TIME}' - got {_some(names)}, expected one; give the "
            "column of times this name"
        )
    times = _numbers(path, TIME, columns[TIME])
    keys = list(zip(*(columns[key] for key in KEYS[:3] if key in columns), strict=True)) or [()] * len(rows)
    starts = [0] + [i + 1 for i, (a, b) in enumerate(pairwise(times)) if b - a <= SAME_TIME or keys[i] != keys[i + 1]]
    spans = list(pairwise([*starts, len(rows)]))
    for start, stop in spans:
        if stop - start < 2 or np.any(np.diff(times[start:stop]) <= 0):
            raise FileFormatError(
                f"trajectory '{path}', line {start + 2}: times do not increase - got "
                f"{times[start:stop][:3].tolist()} in one phase, expected at least two increasing times [s]; "
                "sort the rows"
            )
    return tuple(_phase(path, columns, times, slice(*span), models) for span in spans)


def _table(path: Path) -> tuple[list[str], list[list[str]]]:
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            names, *rows = list(csv.reader(stream, strict=True)) or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FileFormatError(
            f"trajectory '{path}': cannot be read - got {error}, expected a CSV file in UTF-8; correct the "
            "path or the file"
        ) from error
    rows = [row for row in rows if row]
    if not rows or len(set(names)) < len(names):
        raise FileFormatError(
            f"trajectory '{path}': has no table - got {len(rows)} rows and the columns {_some(names)}, expected a "
            "line of different names and rows of values; correct the file"
        )
    for number, row in enumerate(rows):
        if len(row) != len(names):
            raise FileFormatError(
                f"trajectory '{path}', row {number + 1}: has another length - got {len(row)} values, expected "
                f"{len(names)}, one per name; correct the file"
            )
    return names, rows


def _phase(
    path: Path, columns: Mapping[str, list[str]], times: Array, rows: slice, models: Sequence[ModelBase]
) -> PhaseTrajectory:
    text = {key: columns[key][rows.start] for key in KEYS if key in columns}
    name = text.get("model", models[0].name if models else "")
    model = next((each for each in models if each.name == name), None)
    if model is None:
        raise FileFormatError(
            f"trajectory '{path}', row {rows.start + 1}: the model is unknown - got '{name}', expected one of "
            f"{[each.name for each in models]}; give the models with which the file was written"
        )
    numbers = {
        key: _numbers(path, key, columns[key][rows])
        for key in {*names_of(model.state), *names_of(model.control)} & set(columns)
    }
    own = times[rows]
    used = {TIME, *KEYS, *numbers}
    outputs, reset_outputs, labels = _outputs(path, {k: v[rows] for k, v in columns.items() if k not in used})
    controls = [numbers.get(key, np.zeros(len(own)))[:-1] for key in names_of(model.control)]
    return PhaseTrajectory(
        name=text.get("phase", "recorded"), mode=text.get("mode", ""), model=model.name, times=own,
        states=_states(path, model.state, numbers, own), state=model.state, control=model.control,
        controls=np.array(controls).T.reshape(len(own) - 1, -1), outputs=outputs, reset_outputs=reset_outputs,
        ends_phase=text.get("ends_phase", "True") == "True", output_labels=labels,
    )  # fmt: skip


_NAME = re.compile(r"(?P<path>\S+?)(?: (?P<label>[^\[\]]+?))?(?: \[(?P<unit>[^\]]*)\])?")


def _outputs(
    path: Path, columns: Mapping[str, Sequence[str]]
) -> tuple[dict[Quantity, Array], dict[Quantity, Array], dict[Quantity, tuple[str, ...]]]:
    """Return the outputs of stages, those of a reset, and the labels of both, from columns of no state or control."""
    stages: dict[tuple[str, str], dict[str, Array]] = {}
    ends: dict[tuple[str, str], dict[str, Array]] = {}
    for name, texts in columns.items():
        found = _NAME.fullmatch(name)
        values = _numbers(path, name, texts)
        present = ~np.isnan(values)
        if found is None or not present.any():
            continue
        group = ends if not present[:-1].any() else stages
        key = found["path"], found["unit"] or ""
        group.setdefault(key, {})[found["label"] or ""] = values[-1:] if group is ends else values[:-1]
    labels: dict[Quantity, tuple[str, ...]] = {}

    def gathered(group: Mapping[tuple[str, str], dict[str, Array]]) -> dict[Quantity, Array]:
        made = {}
        for (name, unit), parts in group.items():
            in_space = [label[-2:] for label in parts] == [" x", " y", " z"] * (len(parts) // 3)
            quantity = Quantity(name, unit, "direction" if in_space else "vector")
            labels[quantity] = tuple(parts)
            made[quantity] = np.array(list(parts.values())).T
        return made

    return gathered(stages), {of: values[0] for of, values in gathered(ends).items()}, labels


def _states(path: Path, space: Manifold, numbers: Mapping[str, Array], times: Array) -> Array:
    """Return the states; velocities that the file lacks are differences of what they are the rates of."""
    parts: dict[str, Array] = {}
    for block in space.blocks:
        names = names_of(Manifold((block,)))
        missing = [name for name in names if name not in numbers]
        if not missing:
            parts[block.quantity.path] = np.array([numbers[name] for name in names]).T
        elif block.rate_of is not None and len(missing) == len(names) and block.rate_of.path in parts:
            of = Manifold((space.block(block.rate_of),))
            values = parts[block.rate_of.path]
            rates = of.np_minus(values[1:], values[:-1]) / np.diff(times)[:, None]
            parts[block.quantity.path] = np.concatenate([rates, rates[-1:]])
        else:
            raise FileFormatError(
                f"trajectory '{path}': has no column '{missing[0]}' - got {_some([*numbers])}, expected one for each "
                f"of {names}; add it"
            )
        if block.quantity.kind == "rotation":
            parts[block.quantity.path] = _unit(path, block.quantity.path, parts[block.quantity.path])
    return np.concatenate([parts[block.quantity.path] for block in space.blocks], axis=1)


def _unit(path: Path, name: str, quaternions: Array) -> Array:
    size = np.linalg.norm(quaternions, axis=1)
    if np.any(np.abs(size - 1) > 1e-3):
        worst = int(np.argmax(np.abs(size - 1)))
        raise FileFormatError(
            f"trajectory '{path}', '{name}': is no rotation - got a quaternion of length {size[worst]:.4g}, expected "
            "1; give unit quaternions (w, x, y, z)"
        )
    exact = np.abs(size - 1) < 1e-12
    return np.where(exact[:, None], quaternions, quaternions / size[:, None])


def _numbers(path: Path, name: str, texts: Sequence[str]) -> Array:
    try:
        return np.array([float(text) if text else np.nan for text in texts])
    except ValueError as error:
        raise FileFormatError(
            f"trajectory '{path}', column '{name}': is no number - got {error}, expected numbers with a decimal point; "
            "correct the file"
        ) from error


def _some(names: Sequence[str]) -> str:
    return f"{list(names[:8])}{' and more' if len(names) > 8 else ''}"
