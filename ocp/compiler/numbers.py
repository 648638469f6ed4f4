"""Numbers: the parameter vectors ``p`` of all nodes, filled from a problem: weights, targets, bounds, slots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError, ShapeError

from ..language import (
    TIME_STEP,
    At,
    Constraint,
    Cost,
    ModelBase,
    Node,
    Parameter,
    ParameterKey,
    Phase,
    PhaseTime,
    check_value,
    rotation,
)
from .bounds import check_bounds
from .layout import Layout
from .mode import LoweredMode
from .parameters import not_a_number
from .transition import LoweredTransition

Array = NDArray[np.float64]
Term = Cost | Constraint


@dataclass(frozen=True, eq=False)
class _Part:
    """A term's parts of ``p``: its weight or its active flag, its target, and the names of its components."""

    k: int
    term: Term
    factor: slice
    target: slice | None
    labels: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Varying:
    """A constraint's bounds that vary over a phase: the parts of ``p`` for the bounds and for which are finite."""

    k: int
    term: Constraint
    side: Literal["lower", "upper"]
    bound: slice
    finite: slice


@dataclass(frozen=True, eq=False)
class _OfMode:
    """The common numbers of the nodes of a mode: parameters, (np,), and the parts that depend on the phase."""

    p: Array
    parts: tuple[_Part, ...]
    varying: tuple[_Varying, ...]


Lowered = LoweredMode | LoweredTransition
"""What has a parameter vector: a mode, for its nodes, or a transition."""


@dataclass(frozen=True, eq=False)
class Tracked:
    """A cost whose target follows the path: the part of ``p`` for the target, and the names of its components."""

    term: Cost
    part: slice
    labels: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _OfPhase:
    """The common numbers of the nodes of a phase, (np,); targets and bounds that differ by node; active terms."""

    p: Array
    tracked: tuple[Tracked, ...]
    varying: tuple[_Varying, ...]
    counts: NDArray[np.bool_]


class Numbers:
    """Fills parameter vectors; numbers that do not change in a mode or a phase are computed once.

    Args:
        terms: the problem's costs and constraints, those of phases included.
        scopes: per term the phase that declares it; None for terms of the whole problem.
        replaced: name and value of the parameters that replace declared ones.
        where: the problem, for messages.
    """

    def __init__(
        self,
        terms: tuple[Term, ...],
        scopes: tuple[Phase | None, ...],
        replaced: Mapping[ParameterKey, tuple[str, Array]],
        where: str,
    ) -> None:
        self.terms, self.scopes, self.replaced, self.where = terms, scopes, replaced, where
        self.applied: set[int] = set()
        self.used: set[ParameterKey] = set()
        self.changing: set[ParameterKey] = set()
        self._modes: dict[Lowered, _OfMode] = {}
        self._weights: dict[tuple[Lowered, int, str], Array] = {}
        self._phases: dict[tuple[Lowered, Phase, frozenset[At]], _OfPhase] = {}
        self._set: set[tuple[ModelBase, str]] = set()

    def of_nodes(self, mode: Lowered, dt: float, nodes: Sequence[Node], phase: Phase, here: frozenset[At]) -> Array:
        """Return the parameters of nodes of one phase at which the same terms apply, (n, np).

        Args:
            mode: the lowered mode, or a transition.
            dt: time step [s].
            nodes: the nodes.
            phase: their motion phase.
            here: the values of ``at`` of the terms that apply: running, at the phase's end, at the horizon's end.
        """
        shared = self._shared(mode, phase, here)
        p: Array = np.tile(shared.p, (len(nodes), 1))
        p[:, mode.layout.slices[TIME_STEP]] = dt
        for row, node in zip(p, nodes, strict=True):
            self._put_changing(row, mode.layout, mode.model, node)
        for each in shared.tracked:
            p[:, each.part] = self._followed(each, nodes)
        if shared.varying:
            self._put_varying(p, mode, shared.varying, nodes, phase)
        return p

    def counts(self, mode: Lowered, phase: Phase, here: frozenset[At]) -> NDArray[np.bool_]:
        """Return whether each term has an effect at such nodes, (terms,); see ``Cost.counts_in``."""
        return self._shared(mode, phase, here).counts

    def tracked(self, mode: Lowered, phase: Phase, here: frozenset[At]) -> tuple[Tracked, ...]:
        """Return the costs whose targets follow the path at such nodes."""
        return self._shared(mode, phase, here).tracked

    def weights(self, k: int, phase: str, labels: tuple[str, ...]) -> Array:
        """Return the weights of cost k in a phase of this name, one per row: the new ones, else the declared ones."""
        term = self.terms[k]
        assert isinstance(term, Cost)  # constraints have none
        if self.replaced and term.counts_in(phase) and (key := ParameterKey("weight", term=k)) in self.replaced:
            return self._new_value(key, len(labels))
        return term.weights(phase, labels)

    def _shared(self, mode: Lowered, phase: Phase, here: frozenset[At]) -> _OfPhase:
        if (mode, phase, here) not in self._phases:
            self._phases[mode, phase, here] = self._of_phase(mode, phase, here)
        return self._phases[mode, phase, here]

    def _value(self, key: ParameterKey, declared: Array) -> Array:
        """Return the value of a parameter: the one that replaces it, or the declared one."""
        return self._new_value(key, declared.size) if key in self.replaced else declared

    def _new_value(self, key: ParameterKey, size: int) -> Array:
        """Return the value that replaces a parameter, (size,)."""
        self.used.add(key)
        name, value = self.replaced[key]
        return check_value(name, key, value, self.where, size)

    # ---- models' slots and the user's parameters

    def _put_model(self, p: Array, layout: Layout, model: ModelBase) -> None:
        """Write the values of a model's slots that do not depend on the node."""
        for slot in model.slots:
            key = ParameterKey("slot", slot.name, model=model.name)
            p[layout.slices[key]] = self._new_value(key, slot.size) if key in self.replaced else slot.default

    def _put_changing(self, p: Array, layout: Layout, model: ModelBase, node: Node) -> None:
        """Write the slots that the model itself sets for a node."""
        for name, value in model.node_parameters(node).items():
            if (model, name) not in self._set:
                self._note_changing(model, name)
            part = layout.slots.get(name)
            if part is not None:
                p[part] = value

    def _note_changing(self, model: ModelBase, name: str) -> None:
        key = ParameterKey("slot", name, model=model.name)
        if key in self.replaced:
            raise not_a_number(self.replaced[key][0], key, self.where)
        self._set.add((model, name))
        self.changing.add(key)

    def _put_user(self, p: Array, layout: Layout, parameters: tuple[Parameter, ...]) -> None:
        """Write the values of the user's parameters."""
        for parameter in parameters:
            key = ParameterKey("parameter", parameter.label)
            self.used.add(key)
            p[layout.slices[key]] = self._value(key, parameter.value)

    # ---- terms

    def _of_mode(self, mode: Lowered) -> _OfMode:
        """Return the common numbers of the nodes of a mode, in all phases."""
        p, slices = np.zeros(mode.layout.size), mode.layout.slices
        self._put_model(p, mode.layout, mode.model)
        self._put_user(p, mode.layout, mode.parameters)
        labels: dict[int, list[str]] = {k: [] for k in mode.bound}
        for row in mode.residuals:
            labels[row.term].append(row.label)
        parts, varying = [], []
        for k in mode.bound:
            term = self.terms[k]
            target = slices.get(ParameterKey("target", term=k))
            for name, value in term.parameters.items():
                key = ParameterKey("parameter", name, term=k)
                if key in slices:  # a cost on a quantity calls no function
                    p[slices[key]] = self._value(key, value)
            if isinstance(term, Constraint):
                varying += self._put_bounds(p, mode, k, term)
            elif target is not None:
                p[target.start] = 1.0  # for a rotation, the identity
            factor = ParameterKey("active" if isinstance(term, Constraint) else "weight", term=k)
            parts.append(_Part(k, term, slices[factor], target, tuple(labels[k])))
        check_bounds(mode, self.terms, p[None])
        return _OfMode(p, tuple(parts), tuple(varying))

    def _of_phase(self, mode: Lowered, phase: Phase, here: frozenset[At]) -> _OfPhase:
        """Return the common numbers of the nodes of a phase, and the targets that differ by node."""
        if mode not in self._modes:
            self._modes[mode] = self._of_mode(mode)
        shared = self._modes[mode]
        p, tracked, counts = shared.p.copy(), [], np.zeros(len(self.terms), dtype=bool)
        for part in shared.parts:
            k, term = part.k, part.term
            applies = self.scopes[k] in (None, phase) and term.at in here and term.applies(phase.name)
            if applies:
                self.applied.add(k)
            if isinstance(term, Constraint):
                p[part.factor] = counts[k] = applies
            elif applies:
                if (mode, k, phase.name) not in self._weights:
                    self._weights[mode, k, phase.name] = self.weights(k, phase.name, part.labels)
                p[part.factor] = self._weights[mode, k, phase.name]
                counts[k] = term.counts_in(phase.name)
                if part.target is not None and term.target is None:
                    tracked.append(Tracked(term, part.target, part.labels))
                elif part.target is not None:
                    p[part.target] = self._fixed(k, term, part.target.stop - part.target.start, part.labels)
        return _OfPhase(p, tuple(tracked), tuple(each for each in shared.varying if counts[each.k]), counts)

    def _put_bounds(self, p: Array, mode: Lowered, k: int, term: Constraint) -> list[_Varying]:
        """Write the bounds of a constraint's rows, and which of them are finite; return those that vary over phases."""
        varying = []
        for key in (ParameterKey("lower", term=k), ParameterKey("upper", term=k)):
            part = mode.layout.slices.get(key)
            if part is None:
                continue
            side: Literal["lower", "upper"] = "lower" if key.kind == "lower" else "upper"
            finite = mode.layout.slices[key.has_bound]
            if term.varies(side):
                if key in self.replaced:
                    raise not_a_number(self.replaced[key][0], key, self.where)
                self.changing.add(key)
                varying.append(_Varying(k, term, side, part, finite))
                continue
            bound = self._value(key, term.bound(side, mode.model, part.stop - part.start))
            p[part], p[finite] = np.where(np.isfinite(bound), bound, 0.0), np.isfinite(bound)
        return varying

    def _put_varying(
        self, p: Array, mode: Lowered, varying: Sequence[_Varying], nodes: Sequence[Node], phase: Phase
    ) -> None:
        """Write bounds that vary over a phase into the parameters of its nodes, (n, np)."""
        times = [PhaseTime(node.phase_time, phase.duration, phase.name, mode.model) for node in nodes]
        for row, at in zip(p, times, strict=True):
            for each in varying:
                bound = each.term.bound_at(each.side, at, each.bound.stop - each.bound.start)
                row[each.bound], row[each.finite] = np.where(np.isfinite(bound), bound, 0.0), np.isfinite(bound)
        check_bounds(mode, self.terms, p, times.__getitem__)

    def _fixed(self, k: int, term: Cost, size: int, labels: tuple[str, ...]) -> Array:
        """Return a cost's own target, (size,).

        Args:
            k: index of the cost.
            term: the cost.
            size: number of stored entries, 4 for a rotation.
            labels: names of the components of a difference.
        """
        assert term.target is not None  # else it follows the path
        rotates = len(labels) < size
        if self.replaced and (key := ParameterKey("target", term=k)) in self.replaced:
            if not rotates:
                return self._new_value(key, size)
            raise ProblemError(
                f"{self.where}, parameter '{self.replaced[key][0]}': is the target of a rotation - got a value for it, "
                "expected none; declare the term with another to="
            )
        if term.target.size == 0:  # a regularised rotation
            return np.array([1.0, 0.0, 0.0, 0.0])
        angles = rotates and term.target.size == 3
        value = _sized(term, rotation.np_from_rpy(term.target) if angles else term.target, size, labels)
        return value / np.linalg.norm(value) if rotates else value

    def _followed(self, each: Tracked, nodes: Sequence[Node]) -> Array:
        """Return the path's targets of a cost at nodes, (n, size); for a rotation, unit quaternions."""
        term, size = each.term, each.part.stop - each.part.start
        quantity = term.quantity
        assert quantity is not None  # only tracked quantities have a target slot
        values = np.empty((len(nodes), size))
        for row, node in zip(values, nodes, strict=True):
            found = node.targets.get(quantity)
            if found is None:
                found = next((value for q, value in node.targets.items() if q.path == quantity.path), None)
            if found is None:
                known = sorted(q.path for q in node.targets if not q.path.startswith("_"))
                raise ProblemError(
                    f"term '{term.name}' ({term.source}): the motion has no target for it - got targets {known}, "
                    f"expected '{quantity}'; give to=..., or put it in the keyframes or the reference"
                )
            row[:] = _sized(term, found, size, each.labels)
        return values / np.linalg.norm(values, axis=1, keepdims=True) if len(each.labels) < size else values


def _sized(term: Cost, value: Array, size: int, labels: tuple[str, ...]) -> Array:
    """Return a target; raise if its number of entries is not ``size``."""
    if np.size(value) != size:
        names = "roll, pitch, yaw" if len(labels) < size else ", ".join(labels)
        raise ShapeError(
            f"term '{term.name}' ({term.source}): target has the wrong size - got {np.size(value)} entries, expected "
            f"{len(labels)} ({names}) [{term.unit or '-'}]; give one per component"
        )
    return value
