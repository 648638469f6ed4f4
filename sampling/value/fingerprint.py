"""Fingerprints: numbers that describe what a value function was learnt for, comparable between processes and machines.

A user's functions are compared by their results: each is called with symbols in place of a model's quantities, and
evaluated at a few fixed points. Names, addresses and bytes of code have no effect. So a function may be renamed, moved
or rewritten if its results stay the same. The terrain and the robot that the quantities are bound to have no effect.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from typing import Any, Literal

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SamplingError
from piaffe.models import Robot, base, feet
from piaffe.ocp import (
    Bound,
    Constraint,
    Cost,
    Nodes,
    NodeView,
    ParameterKey,
    Phase,
    PhaseTime,
    Quantities,
    Quantity,
    call,
    column,
    find_parameter,
)

from ..options import Options
from ..reward import Reward
from .inputs import ValueInputs, targets

Array = NDArray[np.float64]
Entries = dict[str, Any]

TOLERANCE = 1e-6  # relative and absolute; numbers that differ by less count as equal
_TIMES = 9  # at which bounds over a phase are compared
_SIDES: tuple[Literal["lower", "upper"], ...] = ("lower", "upper")
_PROBES = 4  # points at which a function is evaluated
_SETTLED = 10.0  # time after which commands are constant [s]
_INSTANTS = 8  # times in a cycle at which the targets of the motion are compared
_DIGITS = 10
_LARGE = 1000  # an array with more entries than this (a height field) is replaced by its digest


def fingerprint(nodes: Nodes, reward: Reward, options: Options, inputs: ValueInputs) -> Entries:
    """Return what a value function depends on, as entries that JSON can hold.

    Args:
        nodes: nodes of the problem.
        reward: the reward as a function of the cost.
        options: options of the controller; only γ₀ and the largest discounts are used.
        inputs: inputs of the value function.
    """
    model = nodes.model
    terms = _terms(nodes)
    return {
        "robot": robot_entry(model.robot) if hasattr(model, "robot") else {"name": model.name},
        "step": nodes.dt,
        "armature": plain(getattr(model, "simulated", model.robot).armature) if hasattr(model, "robot") else None,
        **_losses(getattr(model, "robot", None)),
        "action": plain(getattr(model, "action", None)),
        "terrain": plain(getattr(model, "terrain", None)),
        "payload": plain(getattr(model, "payload", None)),
        "motion": _motion(nodes),
        "objective": {name: entry for name, entry in terms.items() if entry["kind"] == "cost"},
        "constraints": {name: entry for name, entry in terms.items() if entry["kind"] != "cost"},
        "reward": {"kind": type(reward).__name__, **plain(vars(reward))},
        "discount": options.discount,
        "p_max": plain(options.p_max),
        "inputs": inputs.spec(nodes.mode),
    }


def differences(kept: Any, now: Any, path: str = "") -> list[tuple[str, Any, Any]]:
    """Return the differences of two fingerprints: (path of the entry, kept, now), for entries without sub-entries."""
    if isinstance(kept, Mapping) and isinstance(now, Mapping):
        found = []
        for name in dict.fromkeys((*kept, *now)):
            inner = f"{path}.{name}" if path else str(name)
            found += differences(kept.get(name), now.get(name), inner)
        return found
    return [] if _same(kept, now) else [(path, kept, now)]


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(_same(x, y) for x, y in zip(a, b, strict=True))
    if _is_number(a) and _is_number(b):
        return bool(np.isclose(a, b, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True))
    return bool(a == b)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


# ---- plain values


def plain(value: Any) -> Any:
    """Return a value as numbers, strings, lists and dictionaries that JSON can hold; infinity and NaN become strings.

    Raises:
        SamplingError: the value contains an object that is not one of numbers, strings or frozen dataclasses of these.
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float | np.number):
        number = float(value)
        return float(f"{number:.{_DIGITS}g}") if np.isfinite(number) else str(number)
    if isinstance(value, np.ndarray) and value.size > _LARGE:
        numbers = np.round(value.astype(float), _DIGITS)
        return {"shape": list(value.shape), "sha256": hashlib.sha256(numbers.tobytes()).hexdigest()}
    if isinstance(value, np.ndarray):
        return [plain(entry) for entry in value.tolist()] if value.ndim else plain(value.item())
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, Quantity):
        return value.path
    if isinstance(value, set | frozenset):
        return sorted(plain(entry) for entry in value)
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if is_dataclass(value) and not isinstance(value, type):
        own = {f.name: plain(getattr(value, f.name)) for f in fields(value) if f.name != "source"}
        return {"kind": type(value).__name__, **own}
    raise SamplingError(
        f"fingerprint: a value has no numbers to compare - got {value!r}, expected numbers, strings or frozen "
        "dataclasses of these; make it one of these"
    )


def _losses(robot: Robot | None) -> Entries:
    """Return damping and dry friction of the joints where there are any, so that files of robots without stay valid."""
    fields = () if robot is None else ("joint_damping", "joint_friction")
    return {name: plain(getattr(robot, name)) for name in fields if np.any(getattr(robot, name))}


def robot_entry(robot: Robot) -> Entries:
    """Return the names of a robot's joints and feet, and the inertial parameters and placements of its links."""
    model = robot.model
    places = [np.concatenate([place.translation, place.rotation.ravel()]) for place in model.jointPlacements]
    frames = [model.frames[robot.frame_id(foot.frame)] for foot in robot.feet]
    return {
        "name": robot.name,
        "joints": list(robot.joint_names),
        "feet": {
            foot.name: plain([int(frame.parentJoint), *frame.placement.translation])
            for foot, frame in zip(robot.feet, frames, strict=True)
        },
        "foot_radius": plain(robot.foot_radius),
        "masses": plain([inertia.mass for inertia in model.inertias]),
        "centres_of_mass": plain(np.array([inertia.lever for inertia in model.inertias])),
        "inertias": plain(np.array([inertia.inertia.ravel() for inertia in model.inertias])),
        "placements": plain(np.array(places)),
        "torque_limit": plain(robot.torque_limit),
    }


# ---- the motion


def _motion(nodes: Nodes) -> Entries:
    """Return the phases, and the target commands and heights of the path after its commands are constant."""
    motion = nodes.problem.motion
    pieces = [
        {name: [_phase(nodes, phase) for phase in part] for name, part in (("once", p.once), ("cycle", p.cycle))}
        for p in motion.pieces
    ]
    cycle = motion.pieces[-1].cycle
    settled = _SETTLED if np.isinf(motion.duration) else 0.0
    length = sum(phase.duration for phase in cycle) if cycle else motion.duration
    every = max(1, round(length / nodes.dt / _INSTANTS))
    nodes_of = [round(settled / nodes.dt) + i * every for i in range(_INSTANTS)]
    commands = [plain(targets(nodes, k)[2:7]) for k in nodes_of]
    heights = []
    for k in nodes_of:
        sample = {quantity.path: value for quantity, value in nodes.sample(k).items()}
        heights.append({name: plain(np.asarray(sample[name])) for name in _HEIGHTS if name in sample})
    return {"pieces": pieces, "commands": commands, "heights": heights}


_HEIGHTS = (base.height.path, feet.height.path)


def _phase(nodes: Nodes, phase: Phase) -> list[Any]:
    mode = nodes.model.resolve(phase.mode)
    return [phase.name, plain(mode) if is_dataclass(mode) else str(mode), plain(phase.duration)]


# ---- terms


def _terms(nodes: Nodes) -> Entries:
    """Return one entry per term by name, without the terms that are left out or that no phase binds."""
    probes = _Probes(nodes)
    names: dict[str, int] = {}
    found = {}
    for k, term in enumerate(nodes.terms):
        names[term.name] = names.get(term.name, 0) + 1
        if k in nodes.mode.bound:
            found[term.name if names[term.name] == 1 else f"{term.name} #{names[term.name]}"] = _term(probes, k, term)
    return found


def _term(probes: _Probes, k: int, term: Cost | Constraint) -> Entries:
    nodes, replaced = probes.nodes, probes.nodes.replaced
    names = [name for name in _scope(nodes, term) if term.applies(name)]
    mask = None if term.mask is None else probes.rows(k, term, term.mask, is_mask=True)
    entry: Entries = {"at": term.at, "mask": mask}
    if isinstance(term, Cost) and term.quantity is not None:
        labels = probes.quantities.bind(term.quantity).labels
        entry |= {
            "quantity": term.quantity.path,
            "target": plain(replaced.get(ParameterKey("target", term=k), term.target)),
        }
    else:
        entry["values"] = probes.rows(k, term, term.function)
        count = len(entry["values"][0])
        labels = tuple(str(i) for i in range(count)) if count > 1 else ("",)
    if isinstance(term, Cost):
        return {"kind": "cost", **entry, "weights": {name: plain(nodes.weights(k, name, labels)) for name in names}}
    for side in _SIDES if term.kind == "inequality" else ():
        key = ParameterKey(side, term=k)
        if term.varies(side):
            entry[side] = {name: plain(values) for name, values in _over_phases(nodes, term, side, len(labels))}
            continue
        declared = None if getattr(term, side) is None else term.bound(side, nodes.model, len(labels))
        entry[side] = plain(replaced.get(key, declared))
    return {"kind": term.kind, **entry, "scale": plain(term.scale_of(nodes.model)), "phases": names}


def _scope(nodes: Nodes, term: Cost | Constraint) -> list[str]:
    """Return the names of the phases that a term belongs to: the one that declares it, or all."""
    return list(dict.fromkeys(phase.name for phase in _phases(nodes, term)))


def _phases(nodes: Nodes, term: Cost | Constraint) -> list[Phase]:
    phases = [phase for piece in nodes.problem.motion.pieces for phase in (*piece.once, *piece.cycle)]
    return [p for p in phases if any(term is t for t in (*p.objective, *p.constraints, *p.until))] or phases


def _over_phases(
    nodes: Nodes, term: Constraint, side: Literal["lower", "upper"], size: int
) -> Iterator[tuple[str, list[Array]]]:
    """Yield the name of each phase in which a term applies, and its bounds at a few times of the phase."""
    for phase in {phase.name: phase for phase in _phases(nodes, term) if term.applies(phase.name)}.values():
        shares = np.linspace(0.0, 1.0, _TIMES).tolist()
        times = [PhaseTime(each * phase.duration, phase.duration, phase.name, nodes.model) for each in shares]
        yield phase.name, [term.bound_at(side, at, size) for at in times]


class _Probes:
    """A node with one free symbol per quantity, of the size that the quantity has in the problem's model."""

    def __init__(self, nodes: Nodes) -> None:
        mode, model = nodes.mode, nodes.model
        p = mode.layout.of_model(cs.SX.sym("p", mode.layout.size))
        space = (cs.SX.sym("x", model.state.nx), cs.SX.sym("u", model.control.nx), cs.SX.sym("z", mode.nz))
        self.nodes, self._real = nodes, model.dynamics(mode.key, *space, p).quantities
        self._symbols: dict[str, Bound] = {}
        makers: dict[str, Callable[[], Bound]] = {path: partial(self._make, path) for path in self._real.paths}
        self.quantities = Quantities(model.name, makers)

    def _make(self, path: str) -> Bound:
        real = self._real.bind(path)
        self._symbols[path] = Bound(real.quantity, cs.SX.sym(path, real.value.numel()), real.labels)
        return self._symbols[path]

    def rows(self, k: int, term: Cost | Constraint, function: Any, *, is_mask: bool = False) -> list[list[Any]]:
        """Return a function of term k at a few points, (points, rows)."""
        replaced = self.nodes.replaced
        given = {} if is_mask else {
            name: cs.SX(replaced.get(ParameterKey("parameter", name, term=k), value))
            for name, value in term.parameters.items()
        }  # fmt: skip
        rows = cs.densify(column(call(function, term.where, NodeView(self.quantities), **given)))
        bound = list(self._symbols.values())
        own = {e.element_hash() for each in bound for e in cs.symvar(each.value)}
        adopted = {p.label: p for p in map(find_parameter, cs.symvar(rows)) if p is not None}
        own |= {e.element_hash() for p in adopted.values() for e in cs.symvar(p)}
        unknown = [symbol.name() for symbol in cs.symvar(rows) if symbol.element_hash() not in own]
        if unknown:
            raise SamplingError(
                f"{term.where}: uses symbols that are not quantities - got {unknown}, expected quantities of the "
                "function's argument, or an ocp.parameter; replace them"
            )
        evaluate = cs.Function("probe", [*(b.value for b in bound), *map(cs.SX, adopted.values())], [rows])
        numbers = [replaced.get(ParameterKey("parameter", label), p.value) for label, p in adopted.items()]
        return [plain(np.array(evaluate(*(_point(b, i) for b in bound), *numbers)).ravel()) for i in range(_PROBES)]


def _point(bound: Bound, probe: int) -> Array:
    """Return numbers for a quantity, which depend only on its name and on the number of the probe."""
    digest = hashlib.sha256(f"{bound.quantity.path} {probe}".encode()).digest()
    values = np.random.default_rng(int.from_bytes(digest[:8], "big")).uniform(-1.0, 1.0, bound.value.numel())
    if bound.quantity.kind == "rotation":
        return np.asarray(values / np.linalg.norm(values))
    if bound.quantity in (feet.contact, feet.landing, feet.lifting):
        return np.asarray(values > 0, dtype=float)
    return values
