"""Data of the figure of a solution: curves over time with name, unit and colour, and their declared limits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piaffe.models import measures
from piaffe.ocp import Quantity

from .angles import continuous_rpy
from .style import AXES, LEGS, colours

if TYPE_CHECKING:
    from piaffe.ocp import PhaseTrajectory
    from piaffe.solvers import Solution

Array = NDArray[np.float64]

_TITLES = {
    "base.position": "Base position", "base.orientation": "Base orientation", "base.linear_velocity": "Base velocity",
    "base.angular_velocity": "Base angular velocity", "joints.position": "angle",
    "joints.velocity": "speed", "joints.torque": "torque",
}  # fmt: skip


@dataclass(frozen=True)
class Curve:
    """One component over time; gaps are NaN.

    Args:
        label: label in the legend.
        times: (n,) [s]. values: (n,).
        colour: colour of the line.
        target: target values of the motion (n,), or None.
        held: whether a value is constant until the next time (a control).
    """

    label: str
    times: Array
    values: Array
    colour: str
    target: Array | None = None
    held: bool = False


@dataclass(frozen=True)
class Panel:
    """One diagram: curves of one unit, and the bounds of their values.

    Args:
        title: title of the diagram. unit: unit of the vertical axis.
        curves: the curves.
        bounds: distinct (lower, upper) of the curves, None where there is no bound.
        moving_bounds: bounds that vary over phases, as times [s] and values (n,) each.
        legend: whether a legend is needed; curves of legs need none, because they have the colours of the contact bars.
    """

    title: str
    unit: str
    curves: tuple[Curve, ...]
    bounds: tuple[tuple[float | None, float | None], ...] = field(default=())
    moving_bounds: tuple[tuple[Array, Array], ...] = field(default=())
    legend: bool = True


def panels(solution: Solution) -> list[Panel]:
    """Return the panels of a solution's states and controls, joints grouped by their place in the leg."""
    found = []
    for quantity, held in _quantities(solution):
        found += list(_panels(solution, quantity, held))
    return found


def feet_of(solution: Solution) -> list[str]:
    """Return the names of the feet whose forces are recorded, in order; empty if there are none."""
    names = []
    for part in solution.trajectory.phases:
        for block in part.control.blocks:
            if block.quantity.path == "feet.force":
                names += [label.rpartition(" ")[0] for label in block.labels]
        recipe = solution.models.get(part.model, {}).get("robot", {})
        names += [foot[0] for foot in recipe.get("feet", ())]
    return list(dict.fromkeys(names))


def forces(solution: Solution) -> tuple[Array, Array]:
    """Return stage times (n,) and recorded forces of the feet (n, nf, 3) [N]; NaN where none are recorded.

    They are in axes of the ground where each foot stands, the normal last: on level ground those of the world.
    """
    count = len(feet_of(solution))
    times, values = [], []
    for part in solution.trajectory.phases:
        stored = next((v for q, v in part.outputs.items() if q.path == "feet.force"), None)
        n = len(part.controls)
        known = stored is not None and stored.shape[1] == 3 * count
        times.append(np.append(part.times[:-1], part.times[-1]))
        table = stored.reshape(n, count, 3) if stored is not None and known else np.full((n, count, 3), np.nan)
        normals = next((v for q, v in part.outputs.items() if q.path == "feet.normal"), None)
        if known and normals is not None:
            table = measures.on_ground(table, normals.reshape(n, count, 3))
        values.append(np.concatenate([table, table[-1:]]))
    return np.concatenate(times), np.concatenate(values)


def impulses(solution: Solution) -> tuple[Array, Array]:
    """Return times of impacts (n,) and impulses (n, nf, 3) [N s], NaN for feet that do not land; n may be 0.

    They are in axes of the ground where each foot lands, the normal last.
    """
    count = len(feet_of(solution))
    found = [impact for impact in measures.impacts(solution.trajectory) if len(impact.impulses) == count]
    values = np.array([impact.on_ground for impact in found]).reshape(-1, count, 3)
    return np.array([impact.time for impact in found]), values


def friction(solution: Solution) -> float | None:
    """Return μ of the declared friction cone; None if there is none."""
    for limit in solution.limits:
        if limit["name"].startswith("friction") and "mu" in limit["parameters"]:
            return float(limit["parameters"]["mu"][0])
    return None


def stance_feet(part: PhaseTrajectory, feet: Sequence[str]) -> list[str] | None:
    """Return the feet on the ground in a phase; None if its mode is not a contact set."""
    names = part.mode.split() if part.mode != "flight" else []
    return names if all(name in feet for name in names) else None


# ---- panels


def _quantities(solution: Solution) -> Iterator[tuple[Quantity, bool]]:
    """Yield each quantity of state and control (without forces) once, states first, and whether it is a control."""
    seen: dict[str, tuple[Quantity, bool]] = {}
    for held in (False, True):
        for part in solution.trajectory.phases:
            for block in (part.control if held else part.state).blocks:
                if block.quantity.path != "feet.force":
                    seen.setdefault(block.quantity.path, (block.quantity, held))
    yield from seen.values()


def _panels(solution: Solution, quantity: Quantity, held: bool) -> Iterator[Panel]:
    labels, times, values, targets = _gather(solution, quantity, held)
    path = quantity.path
    if path.startswith("joints."):
        feet = feet_of(solution)
        bounds, moving = _bounds(solution, path, quantity.unit, labels), _moving(solution, path, quantity.unit, labels)
        for kind, indices, names in _by_kind(labels, feet):
            palette = [LEGS[feet.index(name) % len(LEGS)] if name in feet else LEGS[0] for name in names]
            if not any(name in feet for name in names):
                palette = colours(len(names))
            yield Panel(
                f"{kind} {_TITLES.get(path, path)}".strip().capitalize()
                if kind.islower()
                else f"{kind} {_TITLES.get(path, path)}",
                quantity.unit,
                tuple(
                    _curve(n, i, times, values, targets, c, held)
                    for n, i, c in zip(names, indices, palette, strict=True)
                ),
                tuple(dict.fromkeys(bounds[i] for i in indices)),
                _distinct(moving, indices),
                legend=not all(name in feet for name in names),
            )
        return
    shown = ("roll", "pitch", "yaw") if quantity.kind == "rotation" else labels
    palette = list(AXES) if len(shown) == 3 else colours(len(shown))
    bounds, moving = _bounds(solution, path, quantity.unit, labels), _moving(solution, path, quantity.unit, labels)
    yield Panel(
        _TITLES.get(path, path), quantity.unit,
        tuple(_curve(shown[i], i, times, values, targets, palette[i], held) for i in range(len(shown))),
        tuple(dict.fromkeys(bounds)), _distinct(moving, range(len(labels))), legend=any(shown),
    )  # fmt: skip


def _curve(name: str, i: int, times: Array, values: Array, targets: Array | None, colour: str, held: bool) -> Curve:
    return Curve(name, times, values[:, i], colour, None if targets is None else targets[:, i], held)


def _gather(solution: Solution, quantity: Quantity, held: bool) -> tuple[tuple[str, ...], Array, Array, Array | None]:
    """Return labels, times (n,), values and targets (n, size) of all phases; NaN in phases without the quantity."""
    labels: tuple[str, ...] = ()
    times: list[Array] = []
    values: list[Array | None] = []
    targets: list[Array | None] = []
    for part, policy in zip(solution.trajectory.phases, solution.phases, strict=True):
        space = part.control if held else part.state
        block = next((b for b in space.blocks if b.quantity.path == quantity.path), None)
        times.append(part.times)
        if block is None:
            values.append(None)
            targets.append(None)
            continue
        labels = block.labels
        where = space.slices[block.quantity]
        if held:
            table = part.controls[:, where]
            values.append(np.concatenate([table, table[-1:]]))
            targets.append(None)
        else:
            values.append(part.states[:, where])
            targets.append(policy.target_states[:, where])
    rotates = quantity.kind == "rotation"
    size = 4 if rotates else len(labels)

    def joined(tables: list[Array | None]) -> Array:
        filled = [np.full((len(t), size), np.nan) if v is None else v for t, v in zip(times, tables, strict=True)]
        return np.concatenate(filled)

    found, aims = joined(values), None if held else joined(targets)
    if rotates:
        found, aims = _angles(found, aims)
    return labels, np.concatenate(times), found, aims


def _angles(found: Array, aims: Array | None) -> tuple[Array, Array | None]:
    """Return roll, pitch, yaw of orientations and of their targets; at the start those of the target are near."""
    if aims is None:
        return continuous_rpy(found), None
    wanted = continuous_rpy(aims)
    first = wanted[np.all(np.isfinite(wanted), axis=1)][:1]
    return continuous_rpy(found, first[0] if first.size else None), wanted


def _by_kind(labels: Sequence[str], feet: Sequence[str]) -> Iterator[tuple[str, list[int], list[str]]]:
    """Yield the joints of each kind (place in the leg): kind, indices and legs; one group if a name has no leg."""
    kinds: dict[str, dict[str, int]] = {}
    for i, label in enumerate(labels):
        leg, _, kind = label.partition("_")
        if leg not in feet or not kind:
            yield "Joint", list(range(len(labels))), list(labels)
            return
        kinds.setdefault(kind.removesuffix("_joint"), {})[leg] = i
    for kind, found in kinds.items():
        yield kind, list(found.values()), list(found)


def _bounds(solution: Solution, path: str, unit: str, labels: Sequence[str]) -> list[tuple[float | None, float | None]]:
    """Return (lower, upper) per component from a declared limit on this quantity, (None, None) if there is none."""
    for limit in solution.limits:
        if limit["kind"] == "inequality" and _bounds_components(limit, path, unit, labels):
            lower, upper = (limit[side] or [None] * len(labels) for side in ("lower", "upper"))
            return list(zip(lower, upper, strict=True))
    return [(None, None)] * len(labels)


def _moving(solution: Solution, path: str, unit: str, labels: Sequence[str]) -> list[tuple[Array, Array]]:
    """Return times (n,) and values (n, size) of each side of a declared limit that varies over phases."""
    for limit in solution.limits:
        if limit.get("over_time") and _bounds_components(limit, path, unit, labels):
            sides = limit["over_time"].values()
            return [(np.array(s["times"]), np.array(s["values"], dtype=float).reshape(-1, len(labels))) for s in sides]
    return []


def _distinct(moving: Sequence[tuple[Array, Array]], indices: Iterable[int]) -> tuple[tuple[Array, Array], ...]:
    """Return the bounds of some components over time, each once."""
    found = {values[:, i].tobytes(): (times, values[:, i]) for times, values in moving for i in indices}
    return tuple(found.values())


def _bounds_components(limit: Mapping[str, object], path: str, unit: str, labels: Sequence[str]) -> bool:
    """Return whether a limit bounds each component of a quantity, according to its labels, unit and name."""
    own = list(limit["labels"])  # type: ignore[call-overload]  # a list of names
    if path.startswith("joints."):
        return own == list(labels) and limit["unit"] == unit
    words = str(limit["name"]).replace("_", " ").split()
    return path in words and len(own) == len(labels)
