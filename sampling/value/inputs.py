"""Inputs of a value function: functions of the state and the targets at a node, independent of the place on the map."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError, UnknownNameError
from piaffe.models import base
from piaffe.ocp import Cost, LoweredMode, Nodes, NodeView, Values, call, column, rotation

from ..evaluators import EngineName, Rows, rows

Array = NDArray[np.float64]

_TINY = 1e-9  # avoids a division by zero: the heading has length zero if the robot's front points straight up


@dataclass(frozen=True)
class Targets:
    """Targets of the motion's path at a node that the inputs can use, as expressions.

    Args:
        heading: cosine and sine of the base's target yaw, (2, 1).
        velocity: target velocity of the base along that heading and to its left, (2, 1) [m/s].
        yaw_rate: target yaw rate, (1, 1) [rad/s].
        phase: cosine and sine of the gait phase angle, one revolution per cycle, (2, 1).
        position: target position of the base on the ground, x and y, (2, 1) [m].
    """

    heading: cs.SX
    velocity: cs.SX
    yaw_rate: cs.SX
    phase: cs.SX
    position: cs.SX


_SIZES = {"heading": 2, "velocity": 2, "yaw_rate": 1, "phase": 2, "position": 2}


@dataclass(frozen=True)
class Feature:
    """One named group of inputs.

    Args:
        name: unique among the inputs of a value function.
        function: function of a node's quantities and :class:`Targets` that returns rows independent of the control.
    """

    name: str
    function: Callable[[Any, Targets], Any]


def _axes(s: Any) -> cs.SX:
    return rotation.matrix(cs.SX(s.base.orientation))


def _toward(heading: cs.SX, v: cs.SX) -> cs.SX:
    """Return the components of a vector (2, 1) along and to the left of a heading."""
    along: cs.SX = cs.vertcat(heading[0] * v[0] + heading[1] * v[1], heading[0] * v[1] - heading[1] * v[0])
    return along


def _yaw_error(s: Any, r: Targets) -> Any:
    forward = _axes(s)[:2, 0]
    return _toward(r.heading, forward / cs.sqrt(cs.sumsqr(forward) + _TINY))


def _linear_velocity(s: Any, _: Targets) -> Any:
    return _axes(s).T @ cs.SX(s.base.linear_velocity)


def _position_error(s: Any, r: Targets) -> Any:
    return _toward(r.heading, cs.SX(s.base.position)[:2] - r.position)


FEATURES = {
    feature.name: feature
    for feature in (
        Feature("ground normal", lambda s, _: s.base.ground_normal),
        Feature("yaw error", _yaw_error),
        Feature("linear velocity", _linear_velocity),
        Feature("angular velocity", lambda s, _: s.base.angular_velocity),
        Feature("base height", lambda s, _: s.base.height),
        Feature("joint positions", lambda s, _: s.joints.position),
        Feature("joint velocities", lambda s, _: s.joints.velocity),
        Feature("feet heights", lambda s, _: s.feet.height),
        Feature("command", lambda _, r: cs.vertcat(r.velocity, r.yaw_rate)),
        Feature("contact", lambda s, _: s.feet.contact),
        Feature("phase", lambda _, r: r.phase),
        Feature("position error", _position_error),
    )
}
"""The features that a value file can name. The normal of the ground below the feet and the velocities are in body axes.
Heights are above the terrain. The yaw error is the cosine and sine of the yaw minus the target yaw. The position error
is in the ground plane, along the target heading and to its left."""

STANDARD = tuple(name for name in FEATURES if name != "position error")


@dataclass(frozen=True)
class ValueInputs:
    """Inputs of a value function: features in order. No feature depends on the absolute position.

    Args:
        features: names of :data:`FEATURES`, or the user's own features.
    """

    features: tuple[Feature, ...]

    def __init__(self, features: Iterable[str | Feature] = STANDARD) -> None:
        found = tuple(feature if isinstance(feature, Feature) else _named(feature) for feature in features)
        names = [feature.name for feature in found]
        if not names or len(set(names)) < len(names):
            raise ProblemError(
                f"value inputs: names are unusable - got {names}, expected one or more, each once; rename or remove one"
            )
        object.__setattr__(self, "features", found)

    @classmethod
    def standard(cls, nodes: Nodes) -> ValueInputs:
        """Return the default inputs, with the position error if the objective tracks the base's horizontal position."""
        follows = any(_tracks_place(k, term, nodes) for k, term in enumerate(nodes.terms) if isinstance(term, Cost))
        return cls((*STANDARD, "position error") if follows else STANDARD)

    def spec(self, mode: LoweredMode) -> dict[str, int]:
        """Return the number of rows of each feature, by name, for a mode."""
        return {name: rows.numel() for name, rows in _expressions(self, mode)[2].items()}

    def labels(self, mode: LoweredMode) -> tuple[str, ...]:
        """Return the name of each row, (m,)."""
        spec = self.spec(mode)
        return tuple(f"{name} {i}" if size > 1 else name for name, size in spec.items() for i in range(size))

    def function(self, mode: LoweredMode) -> cs.Function:
        """Return the inputs as a function (x, p) → rows; p contains the mode's parameters and the node's targets.

        Raises:
            ProblemError: a feature depends on the control, or raises an error.
            UnknownNameError: the model cannot supply a feature's quantity.
        """
        x, p, found = _expressions(self, mode)
        return cs.Function("value_inputs", [x, p], [cs.densify(cs.vertcat(*found.values()))], ["x", "p"], ["rows"])

    def bind(self, nodes: Nodes, engine: EngineName = "native", *, threads: int | None = None) -> BoundInputs:
        """Return an object that evaluates the inputs at the nodes of a problem."""
        return BoundInputs(nodes, rows(self.function(nodes.mode), engine, threads=threads))


class BoundInputs:
    """Inputs of states at the nodes of a problem.

    Args:
        nodes: the nodes.
        rows: evaluator of :meth:`ValueInputs.function`.
    """

    def __init__(self, nodes: Nodes, rows: Rows) -> None:
        self.nodes, self._rows = nodes, rows
        self._numbers: dict[int, Array] = {}

    def __call__(self, states: Array, k: int) -> Array:
        """Return the inputs of states (n, nx) at node k, (n, m); the next call of this size may overwrite them."""
        if k not in self._numbers:
            if len(self._numbers) > _KEPT:
                self._numbers.clear()
            self._numbers[k] = np.concatenate([self.nodes.running(k, 1).p[0], targets(self.nodes, k)])[None]
        return np.asarray(self._rows(states[:, None], None, self._numbers[k])[:, 0])


_KEPT = 4096  # number of nodes whose parameters are kept in memory


def targets(nodes: Nodes, k: int) -> Array:
    """Return the numbers of :class:`Targets` at node k, (9,); a target that the path lacks is zero or the identity."""
    sample = {quantity.path: np.asarray(value, dtype=float) for quantity, value in nodes.sample(k).items()}
    turned = rotation.np_matrix(sample.get(base.orientation.path, np.eye(4)[0]))[:2, 0]
    heading = turned / max(float(np.linalg.norm(turned)), _TINY)
    vx, vy = sample.get(base.linear_velocity.path, np.zeros(3))[:2]
    velocity = [heading[0] * vx + heading[1] * vy, heading[0] * vy - heading[1] * vx]
    rate = sample.get(base.angular_velocity.path, np.zeros(3))[2]
    angle = clock(nodes, k)
    place = sample.get(base.position.path, np.zeros(3))[:2]
    return np.array([*heading, *velocity, rate, np.cos(angle), np.sin(angle), *place])


def clock(nodes: Nodes, k: int) -> float:
    """Return the gait phase angle at node k [rad]: 0 at the start of a cycle, 2π per cycle, negative before the cycle.

    In a piece of motion without a cycle, the angle goes from 0 at the start to π at the end.
    """
    interval = nodes.interval(k)
    piece = nodes.problem.motion.pieces[interval.piece]
    since = min(k * nodes.dt, interval.end) - interval.start
    once = sum(phase.duration for phase in piece.once)
    if not piece.cycle:
        before = sum(phase.duration for phase in piece.once[: interval.index])
        return float(np.pi * (before + since) / once)
    period = sum(phase.duration for phase in piece.cycle)
    if interval.index < len(piece.once):
        before = sum(phase.duration for phase in piece.once[: interval.index]) - once
    else:
        done = (interval.index - len(piece.once)) % len(piece.cycle)
        before = sum(phase.duration for phase in piece.cycle[:done])
    return float(2 * np.pi * (before + since) / period)


# ---- lowering


_LOWERED: WeakKeyDictionary[LoweredMode, dict[ValueInputs, Any]] = WeakKeyDictionary()


def _expressions(inputs: ValueInputs, mode: LoweredMode) -> tuple[cs.SX, cs.SX, dict[str, cs.SX]]:
    """Return x, p and the rows of each feature by name."""
    kept = _LOWERED.setdefault(mode, {})
    if inputs not in kept:
        kept[inputs] = _lower(inputs, mode)
    found: tuple[cs.SX, cs.SX, dict[str, cs.SX]] = kept[inputs]
    return found


def _lower(inputs: ValueInputs, mode: LoweredMode) -> tuple[cs.SX, cs.SX, dict[str, cs.SX]]:
    model = mode.model
    x, u = cs.SX.sym("x", model.state.nx), cs.SX.sym("u", model.control.nx)
    z, own = cs.SX.sym("z", mode.nz), cs.SX.sym("p", mode.layout.size)
    parts = {name: cs.SX.sym(f"target_{name}", size) for name, size in _SIZES.items()}
    view = NodeView(model.dynamics(mode.key, x, u, z, mode.layout.of_model(own)).quantities)
    p = cs.vertcat(own, *parts.values())
    found = {}
    for feature in inputs.features:
        where = f"value input '{feature.name}'"
        value = column(call(feature.function, where, view, Targets(**parts)))
        value = cs.SX(value) if isinstance(value, Values) else value
        known = {symbol.element_hash() for symbol in cs.symvar(cs.vertcat(x, p))}
        if any(symbol.element_hash() not in known for symbol in cs.symvar(value)):
            raise ProblemError(
                f"{where}: depends on something else than state and targets - got an expression of "
                f"{sorted({s.name() for s in cs.symvar(value)})}, expected no control, contact force or parameter; "
                "remove it from the feature"
            )
        found[feature.name] = cs.densify(value)
    return x, p, found


def _named(name: str) -> Feature:
    if name not in FEATURES:
        raise UnknownNameError("value inputs", "feature", name, FEATURES)
    return FEATURES[name]


def _tracks_place(k: int, term: Cost, nodes: Nodes) -> bool:
    if term.quantity is None or term.quantity != base.position or term.at != "running":
        return False
    return any(
        np.any(nodes.weights(k, phase.name, ("x", "y", "z"))[:2] > 0)
        for piece in nodes.problem.motion.pieces
        for phase in (*piece.once, *piece.cycle)
    )
