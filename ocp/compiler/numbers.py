"""Numbers: the parameter vectors ``p`` of all nodes, filled from a problem: weights, targets, bounds, slots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError, ShapeError

from ..language import At, Constraint, Cost, ModelBase, Node, Parameter, Phase, Problem, rotation
from .layout import Layout
from .mode import LoweredMode
from .transition import LoweredTransition

Array = NDArray[np.float64]
Term = Cost | Constraint


@dataclass(frozen=True, eq=False)
class _Slot:
    """A term's place in ``p``: its number, what scales it (weight or active), its target, names of its components."""

    k: int
    term: Term
    factor: slice
    target: slice | None
    labels: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _OfMode:
    """What the nodes of a mode share: numbers, (np,), and where those are that depend on the phase."""

    p: Array
    slots: tuple[_Slot, ...]


@dataclass(frozen=True, eq=False)
class _Tracked:
    """A cost whose target follows the path: where in ``p`` it goes, and the names of its components."""

    term: Cost
    part: slice
    labels: tuple[str, ...]


class Numbers:
    """Fills parameter vectors; what does not change within a mode or a phase is worked out once.

    Args:
        problem: the declaration.
        terms: its costs and constraints, those of phases included.
        scopes: per term the phase that declares it, None for all.
    """

    def __init__(self, problem: Problem, terms: tuple[Term, ...], scopes: tuple[Phase | None, ...]) -> None:
        self.problem, self.terms, self.scopes = problem, terms, scopes
        self.applied: set[int] = set()
        self.used: set[str] = set()
        self.changing: set[str] = set()
        self._modes: dict[LoweredMode, _OfMode] = {}
        self._weights: dict[tuple[LoweredMode, int, str], Array] = {}
        self._phases: dict[tuple[LoweredMode, Phase, frozenset[At]], tuple[Array, list[_Tracked]]] = {}

    def of_nodes(self, mode: LoweredMode, dt: float, nodes: Sequence[Node], phase: Phase, here: frozenset[At]) -> Array:
        """Return the parameters of nodes of one phase at which the same terms hold, (n, np).

        Args:
            mode: the lowered mode.
            dt: time step [s].
            nodes: what the model is asked with.
            phase: their motion phase.
            here: which terms hold: running ones, those of a phase's end, those of the horizon's end.
        """
        if (mode, phase, here) not in self._phases:
            self._phases[mode, phase, here] = self._of_phase(mode, phase, here)
        constant, tracked = self._phases[mode, phase, here]
        p: Array = np.tile(constant, (len(nodes), 1))
        for row, node in zip(p, nodes, strict=True):
            _put(row, mode.layout, self._changing(mode.model, dt, node))
        for each in tracked:
            p[:, each.part] = self._followed(each, nodes)
        return p

    def of_transition(self, transition: LoweredTransition, dt: float, node: Node) -> Array:
        """Return the parameters of a transition, (np,)."""
        p = np.zeros(transition.layout.size)
        for values in (
            self._of_model(transition.source),
            self._of_user(transition.parameters),
            self._changing(transition.source, dt, node),
        ):
            _put(p, transition.layout, values)
        return p

    # ---- models' slots and the user's parameters

    def _of_model(self, model: ModelBase) -> dict[str, Array]:
        """Return the values of a model's slots, the user's before the defaults."""
        values = {}
        for slot in model.slots:
            name = f"{model.name}.{slot.name}"
            given = self.problem.parameters.get(name)
            if given is not None:
                self.used.add(name)
                self._check_size(name, given, slot.size)
            values[f"model.{slot.name}"] = np.asarray(slot.default if given is None else given, dtype=float)
        return values

    def _changing(self, model: ModelBase, dt: float, node: Node) -> dict[str, Array]:
        """Return dt and the slots that the model itself sets for a node."""
        values = {"dt": np.array([dt])}
        for name, value in model.node_parameters(node).items():
            self.changing.add(f"{model.name}.{name}")
            if f"{model.name}.{name}" in self.problem.parameters:
                raise ProblemError(
                    f"problem ({self.problem.source}), parameter '{model.name}.{name}': follows from the motion - got "
                    "a number for it, expected none; change the motion's phases or targets"
                )
            values[f"model.{name}"] = np.asarray(value, dtype=float)
        return values

    def _of_user(self, parameters: tuple[Parameter, ...]) -> dict[str, Array]:
        """Return the values of the user's parameters."""
        values = {}
        for parameter in parameters:
            given = self.problem.parameters.get(parameter.label, parameter.value)
            self.used.add(parameter.label)
            self._check_size(parameter.label, given, parameter.value.size)
            values[f"parameter.{parameter.label}"] = given
        return values

    def _check_size(self, name: str, given: Array, size: int) -> None:
        if given.size != size:
            raise ShapeError(
                f"problem ({self.problem.source}), parameter '{name}': wrong size - got {given.size} entries, expected "
                f"{size}; give as many as the default has"
            )

    # ---- terms

    def _of_mode(self, mode: LoweredMode) -> _OfMode:
        """Return what the nodes of a mode share, whichever their phase."""
        p = np.zeros(mode.layout.size)
        _put(p, mode.layout, self._of_model(mode.model))
        _put(p, mode.layout, self._of_user(mode.parameters))
        labels: dict[int, list[str]] = {k: [] for k in mode.bound}
        for group, running in (("stage", True), ("terminal", False)):
            for row in mode.rows[f"{group}_residual"]:
                if (self.terms[row.term].at == "running") is running:
                    labels[row.term].append(row.label)
        for k in mode.bound:
            term = self.terms[k]
            _put(p, mode.layout, {f"term{k}.{name}": value for name, value in term.parameters.items()})
            if isinstance(term, Constraint):
                _put(p, mode.layout, self._bounds(mode, k, term))
            elif (part := mode.layout.slices.get(f"term{k}.target")) is not None:
                p[part.start] = 1.0  # of a rotation the identity
        slices = mode.layout.slices
        slots = (
            _Slot(
                k, term, slices[f"term{k}.{'active' if isinstance(term, Constraint) else 'weight'}"],
                slices.get(f"term{k}.target"), tuple(labels[k]),
            )
            for k, term in ((k, self.terms[k]) for k in mode.bound)
        )  # fmt: skip
        return _OfMode(p, tuple(slots))

    def _of_phase(self, mode: LoweredMode, phase: Phase, here: frozenset[At]) -> tuple[Array, list[_Tracked]]:
        """Return what the nodes of a phase share, and which targets are still to be filled in."""
        if mode not in self._modes:
            self._modes[mode] = self._of_mode(mode)
        shared = self._modes[mode]
        p, tracked = shared.p.copy(), []
        for slot in shared.slots:
            k, term = slot.k, slot.term
            applies = self.scopes[k] in (None, phase) and term.at in here and term.applies(phase.name)
            if applies:
                self.applied.add(k)
            if isinstance(term, Constraint):
                p[slot.factor] = applies
            elif applies:
                if (mode, k, phase.name) not in self._weights:
                    self._weights[mode, k, phase.name] = term.weights(phase.name, slot.labels)
                p[slot.factor] = self._weights[mode, k, phase.name]
                if slot.target is not None and term.target is None:
                    tracked.append(_Tracked(term, slot.target, slot.labels))
                elif slot.target is not None:
                    p[slot.target] = _fixed(term, slot.target.stop - slot.target.start, slot.labels)
        return p, tracked

    def _bounds(self, mode: LoweredMode, k: int, term: Constraint) -> dict[str, Array]:
        """Return the bounds of a constraint's rows, and which of them are finite."""
        values: dict[str, Array] = {}
        for side in ("lower", "upper"):
            part = mode.layout.slices.get(f"term{k}.{side}")
            if part is not None:
                bound = term.bound(side, mode.model, part.stop - part.start)
                finite = np.isfinite(bound)
                values[f"term{k}.{side}"] = np.where(finite, bound, 0.0)
                values[f"term{k}.has_{side}"] = finite.astype(float)
        if f"term{k}.lower" in values and f"term{k}.upper" in values:
            self._check_order(mode, k, term, values)
        return values

    def _check_order(self, mode: LoweredMode, k: int, term: Constraint, values: Mapping[str, Array]) -> None:
        both = values[f"term{k}.has_lower"] * values[f"term{k}.has_upper"]
        lower, upper = values[f"term{k}.lower"], values[f"term{k}.upper"]
        for i in np.flatnonzero(both * (lower > upper)):
            raise ProblemError(
                f"constraint '{term.name}' ({term.source}), model '{mode.model.name}', row {i}: bounds exclude each "
                f"other - got lower {lower[i]:g} above upper {upper[i]:g} [{term.unit or '-'}], expected lower ≤ "
                "upper; swap them"
            )

    def _followed(self, each: _Tracked, nodes: Sequence[Node]) -> Array:
        """Return the path's targets of a cost at nodes, (n, size); of a rotation unit quaternions."""
        term, size = each.term, each.part.stop - each.part.start
        quantity = term.quantity
        assert quantity is not None  # only tracked quantities have a target slot
        values = np.empty((len(nodes), size))
        for row, node in zip(values, nodes, strict=True):
            found = node.sample.get(quantity)
            if found is None:
                found = next((given for q, given in node.sample.items() if q.path == quantity.path), None)
            if found is None:
                raise ProblemError(
                    f"term '{term.name}' ({term.source}): the motion has no target for it - got targets "
                    f"{sorted(q.path for q in node.sample)}, expected '{quantity}'; give to=..., or put it in the "
                    "keyframes or the reference"
                )
            row[:] = _sized(term, found, size, each.labels)
        return values / np.linalg.norm(values, axis=1, keepdims=True) if len(each.labels) < size else values


def _fixed(term: Cost, size: int, labels: tuple[str, ...]) -> Array:
    """Return a cost's own target, (size,).

    Args:
        term: the cost.
        size: stored entries, 4 for a rotation.
        labels: names of the components of a difference.
    """
    value, rotates = term.target, len(labels) < size
    assert value is not None  # else it follows the path
    if value.size == 0:  # a regularised rotation
        return np.array([1.0, 0.0, 0.0, 0.0])
    if rotates and value.size == 3:
        value = rotation.np_from_rpy(value)
    value = _sized(term, value, size, labels)
    return value / np.linalg.norm(value) if rotates else value


def _sized(term: Cost, value: Array, size: int, labels: tuple[str, ...]) -> Array:
    """Return a target; raise if it has not ``size`` entries."""
    if np.size(value) != size:
        names = "roll, pitch, yaw" if len(labels) < size else ", ".join(labels)
        raise ShapeError(
            f"term '{term.name}' ({term.source}): target has the wrong size - got {np.size(value)} entries, expected "
            f"{len(labels)} ({names}) [{term.unit or '-'}]; give one per component"
        )
    return value


def _put(p: Array, layout: Layout, values: Mapping[str, Array]) -> None:
    """Write values into their parts of a vector; those that it has no part for are not needed there."""
    for name, value in values.items():
        part = layout.slices.get(name)
        if part is not None:
            p[part] = value
