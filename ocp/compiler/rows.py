"""Rows: the components of a term in a mode, as an expression of the node, with weights, masks and names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as cs

from piaffe.errors import ProblemError, ShapeError

from ..language import (
    Bound,
    Constraint,
    Cost,
    ModelBase,
    NodeView,
    ParameterKey,
    Quantities,
    ResetRows,
    call,
    column,
    rotation,
)
from .mode import Row
from .symbols import NodeSymbols


@dataclass(frozen=True)
class Rows:
    """Rows of one term.

    Args:
        value: expression of the node.
        weight: weights of a cost's rows; None for a constraint.
        mask: 1 for rows that apply, 0 for others.
        names: one per row.
    """

    value: cs.SX
    weight: cs.SX | None
    mask: cs.SX
    names: tuple[Row, ...]


class TermBinder:
    """Binds terms to a node.

    Args:
        model: the node's model.
        quantities: the quantities there, as expressions of the symbols.
        symbols: the node's symbols; each bound term adds its parameters to them.
        terms: the problem's terms.
    """

    def __init__(
        self, model: ModelBase, quantities: Quantities, symbols: NodeSymbols, terms: Sequence[Cost | Constraint]
    ) -> None:
        self._model, self._quantities, self._symbols, self._terms = model, quantities, symbols, terms
        self._view = NodeView(quantities)

    def bind(self, index: int) -> Rows:
        """Return a term's rows.

        Raises:
            UnknownNameError: the model does not supply a quantity of the term.
            ProblemError, ShapeError: the term's function, mask or labels are unusable.
        """
        term = self._terms[index]
        return self._cost(index, term) if isinstance(term, Cost) else self._constraint(index, term)

    def bind_at_reset(self, index: int) -> Rows:
        """Return the rows of a term at a reset: a constraint's ``at_reset``, or all rows of a term at phases' ends."""
        term = self._terms[index]
        if isinstance(term, Cost) or term.at_reset is None:
            return self.bind(index)
        return self._reset_rows(index, term, term.at_reset)

    def _reset_rows(self, index: int, constraint: Constraint, rows: ResetRows) -> Rows:
        where = f"constraint '{constraint.name}' ({constraint.source}), at a reset"
        value = self._evaluate(index, rows.function)
        labels, mask = self._labels(rows.labels, value.numel(), where), self._active(index, rows.mask, value, where)
        given = self._model.sizes.of(rows.unit) if rows.scale is None else rows.scale
        scale = float(given(self._model) if callable(given) else given)
        return Rows(value / scale, None, mask, tuple(Row(index, x, rows.unit, scale) for x in labels))

    def _cost(self, index: int, cost: Cost) -> Rows:
        if cost.quantity is not None:
            bound = self._quantities.bind(cost.quantity)
            value, labels, mask = self._difference(bound, index, cost), bound.labels, bound.mask
            unit, rotates = cost.unit or bound.quantity.unit, bound.quantity.kind == "rotation"
        else:
            value = self._evaluate(index, cost.function)
            labels = tuple(str(i) for i in range(value.numel())) if value.numel() > 1 else ("",)
            mask, unit, rotates = None, cost.unit, False
        if cost.mask is not None:
            extra = self._repeated(
                self._evaluate(index, cost.mask, is_mask=True), value.numel(), f"term '{cost.name}' ({cost.source})"
            )
            mask = extra if mask is None else mask * extra
        weight = self._symbols.part(ParameterKey("weight", term=index), value.numel())
        names = tuple(Row(index, label, unit, rotates=rotates) for label in labels)
        return Rows(value, weight, cs.SX.ones(value.numel()) if mask is None else mask, names)

    def _difference(self, bound: Bound, index: int, cost: Cost) -> cs.SX:
        """Return value ⊖ target of a tracked quantity."""
        if cost.target is not None and cost.target.size == 0 and bound.quantity.kind != "rotation":
            return bound.value
        target = self._symbols.part(ParameterKey("target", term=index), bound.value.numel())
        if bound.quantity.kind == "rotation":
            return rotation.log(rotation.multiply(rotation.conjugate(target), bound.value))
        return bound.value - target

    def _constraint(self, index: int, constraint: Constraint) -> Rows:
        """Return value − lower and upper − value, divided by the constraint's scale."""
        where = f"constraint '{constraint.name}' ({constraint.source})"
        value = self._evaluate(index, constraint.function)
        n = value.numel()
        labels, mask = self._labels(constraint.labels, n, where), self._active(index, constraint.mask, value, where)
        unit, scale = constraint.unit, constraint.scale_of(self._model)
        if constraint.kind == "equality":
            return Rows(value / scale, None, mask, tuple(Row(index, x, unit, scale) for x in labels))
        rows, masks, names = [], [], []
        for side, sign in ((ParameterKey("lower", term=index), 1), (ParameterKey("upper", term=index), -1)):
            if getattr(constraint, side.kind) is None:
                continue
            bound, finite = self._symbols.part(side, n), self._symbols.part(side.has_bound, n)
            rows.append(sign * (value - bound) / scale)
            masks.append(mask * finite)
            names += [Row(index, x, unit, scale, side.kind) for x in labels]
        return Rows(cs.vertcat(*rows), None, cs.vertcat(*masks), tuple(names))

    def _labels(self, given: Any, n: int, where: str) -> tuple[str, ...]:
        """Return the names of n rows."""
        labels = given(self._model) if callable(given) else given
        labels = tuple(labels) if labels is not None else tuple(str(i) for i in range(n)) if n > 1 else ("",)
        if len(labels) != n:
            raise ShapeError(
                f"{where}: labels do not match the rows - got {len(labels)}, expected {n}; give one per row"
            )
        return labels

    def _active(self, index: int, mask: Any, value: cs.SX, where: str) -> cs.SX:
        """Return the mask of a constraint's rows; it is zero where the constraint does not apply."""
        active = cs.SX.ones(value.numel()) * self._symbols.part(ParameterKey("active", term=index), 1)
        if mask is None:
            return active
        return active * self._repeated(self._evaluate(index, mask, is_mask=True), value.numel(), where)

    def _evaluate(self, index: int, function: Any, *, is_mask: bool = False) -> cs.SX:
        """Call a user's function and return its rows as a column; masks get no parameters."""
        term = self._terms[index]
        numbers = {
            name: self._symbols.part(
                ParameterKey("parameter", name, term=index, positive=name in term.positive), value.size
            )
            for name, value in ({} if is_mask else term.parameters).items()
        }
        where = f"term '{term.name}' ({term.source})"
        result = call(function, where, self._view, **numbers)
        if isinstance(result, NodeView):
            raise ProblemError(
                f"{where}: the function returned a group - got a group of quantities, expected numbers; name one of "
                "them"
            )
        try:
            rows = column(result)
            self._check_column(where, result)
        except NotImplementedError as error:  # CasADi raises this if it cannot convert the result
            raise ProblemError(
                f"{where}: the function's result is unusable - got {type(result).__name__}, expected a CasADi column; "
                "return one"
            ) from error
        if rows.numel() == 0:
            raise ShapeError(f"{where}: the function returned no rows - got 0, expected at least one; return some")
        self._symbols.check(where, rows)
        return cs.densify(rows)

    def _check_column(self, where: str, result: Any) -> None:
        """Raise if a function's result, which CasADi can convert, is a matrix: its rows have no order."""
        shape = cs.SX(cs.vertcat(*result) if isinstance(result, list | tuple) else result).shape
        if min(shape) > 1:
            raise ShapeError(
                f"{where}: the function returned a matrix - got shape {shape}, expected a column; return casadi.vec of "
                "it, or the rows that count"
            )

    def _repeated(self, mask: cs.SX, count: int, where: str) -> cs.SX:
        """Return a mask with one entry per row; a mask of fewer entries is repeated blockwise."""
        if count % mask.numel():
            raise ShapeError(
                f"{where}: mask has the wrong size - got {mask.numel()} entries, expected a divisor of {count} rows; "
                "fix it"
            )
        if cs.depends_on(mask, cs.vertcat(self._symbols.x, self._symbols.u, self._symbols.z)):
            raise ProblemError(
                f"{where}: mask depends on state or control - got an expression of x, u or z, expected numbers of the "
                "node (contact flags); fix it"
            )
        return cs.kron(mask, cs.SX.ones(count // mask.numel()))
