"""Lowering: one mode of a model and the terms that bind there, as pure CasADi functions.

The functions of a mode, with w = (δx, u) and d = f ⊖ x_next (δx is taken at zero, through the manifold):

=============  ============================================  ====================================================
implicit       (x, u, p)         → K, r0                     the implicit part r = r0 + K z, z = −K⁻¹ r0
stage          (x, u, z, p)      → x_next, residual, g, h    one stage; rows of running terms
stage_d        (x, u, z, p, xn)  → r_w, and d, residual, g,
                                   h by w and by z
guess_d        as stage_d        → the same but for what is finite wherever x, u and z are, which is zero
stage_w        (p)               → weight, g_mask, h_mask    numbers per row; a masked row counts for nothing
terminal       (x, p)            → residual, g, h            the last node of a phase
terminal_d     (x, p)            → residual_x, g_x, h_x
terminal_w     (p)               → weight, g_mask, h_mask
outputs        (x, u, z, p)      → recorded quantities
=============  ============================================  ====================================================

Inequalities are g ≥ 0, already divided by the row's scale, as equalities are. A mode of a model without derivatives has
neither implicit, stage_d and terminal_d nor x_next: its step is the simulator's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as cs

from piaffe.errors import ProblemError, ShapeError, UnknownNameError

from . import rotation
from .functions import is_smooth, make_derivatives, make_function
from .given import call
from .layout import Layout
from .linear import affine, tangent_jacobians
from .manifold import Manifold
from .model import Dynamics, ModelBase
from .parameter import Parameter, find
from .quantity import Bound, Quantity
from .term import Constraint, Cost
from .view import NodeView, column

LEFT_OUT = "left out by the schedule"


@dataclass(frozen=True)
class Row:
    """One row of a residual or constraint.

    Args:
        term: index into the problem's terms; -1 for rows that the model derives (switching).
        label: name of the component.
        unit: its unit.
        scale: what the raw SI amount was divided by.
        side: ``"lower"`` or ``"upper"`` of an inequality.
        rotates: whether it is a component of a rotation's difference.
    """

    term: int
    label: str
    unit: str
    scale: float = 1.0
    side: str = ""
    rotates: bool = False


@dataclass(frozen=True, eq=False)
class LoweredMode:
    """A mode's functions, sizes, rows and parameter layout."""

    model: ModelBase
    key: str
    layout: Layout
    parameters: tuple[Parameter, ...]
    nz: int
    functions: Mapping[str, cs.Function]
    rows: Mapping[str, tuple[Row, ...]]
    outputs: tuple[tuple[Quantity, int], ...]
    bound: tuple[int, ...]
    unbound: Mapping[int, str]

    @property
    def state(self) -> Manifold:
        """The state space."""
        return self.model.state

    @property
    def nu(self) -> int:
        """Number of controls."""
        return self.model.control.nx


@dataclass(frozen=True)
class _Piece:
    """Rows of one term: expression, weight or nothing, mask, names."""

    rows: cs.SX
    weight: cs.SX | None
    mask: cs.SX
    labels: tuple[Row, ...]


class Lowering:
    """Builds a :class:`LoweredMode`; lives only while doing so."""

    def __init__(
        self, model: ModelBase, key: str, terms: tuple[Cost | Constraint, ...], excluded: frozenset[int]
    ) -> None:
        self.model, self.key, self.terms = model, key, terms
        self.excluded = excluded
        self.x = cs.SX.sym("x", model.state.nx)
        self.u = cs.SX.sym("u", model.control.nx)
        self.z = cs.SX.sym("z", model.implicit_size(key))
        self.slots: dict[str, cs.SX] = {"dt": cs.SX.sym("dt")}
        for slot in model.slots:
            self.slots[f"model.{slot.name}"] = cs.SX.sym(slot.name, slot.size)
        self.parameters: dict[str, Parameter] = {}
        self.unbound: dict[int, str] = {}

    def model_slots(self) -> dict[str, cs.SX]:
        """Return the symbols that a model sees in ``p``."""
        named = {name.removeprefix("model."): s for name, s in self.slots.items() if name.startswith("model.")}
        return {**named, "dt": self.slots["dt"]}

    def own(self, name: str, size: int) -> cs.SX:
        """Return a fresh slot of the parameter vector."""
        self.slots[name] = cs.SX.sym(name, size)
        return self.slots[name]

    def check_symbols(self, where: str, expression: cs.SX, absent: cs.SX | None = None) -> None:
        """Adopt user parameters in an expression; raise if it holds a symbol that is not of this node."""
        if absent is not None and cs.depends_on(expression, absent):
            raise ProblemError(
                f"{where}: depends on control or contact force where there is none - got an expression of them at the "
                "end of a phase, expected one of the state; change it"
            )
        own = {
            e.element_hash()
            for part in (self.x, self.u, self.z, *self.slots.values(), *self.parameters.values())
            for e in cs.symvar(part)
        }
        for symbol in cs.symvar(expression):
            if symbol.element_hash() in own:
                continue
            parameter = find(symbol)
            if parameter is None:
                raise ProblemError(
                    f"{where}: a symbol is not from the node's quantities - got '{symbol.name()}', expected only what "
                    "the function's argument supplies (or an ocp.parameter); compute it inside the function from its "
                    "argument"
                )
            self.adopt(parameter)
            own |= {e.element_hash() for e in cs.symvar(parameter)}

    def adopt(self, parameter: Parameter) -> None:
        """Give a user's parameter a slot."""
        name = f"parameter.{parameter.label}"
        if self.parameters.get(name, parameter) is not parameter:
            raise ProblemError(
                f"parameter '{parameter.label}': two parameters share a name - got two objects, expected one; rename "
                "one"
            )
        self.parameters[name] = parameter
        self.slots[name] = cs.SX(parameter)

    # ---- terms

    def evaluate(self, view: NodeView, index: int, function: Any, *, is_mask: bool = False) -> cs.SX:
        """Call a user's function and return its rows as a column; masks get no parameters."""
        term = self.terms[index]
        numbers = {}
        for name, value in () if is_mask else term.parameters.items():
            slot = f"term{index}.{name}"
            numbers[name] = self.slots[slot] if slot in self.slots else self.own(slot, value.size)
        where = f"term '{term.name}' ({term.source})"
        result = call(function, where, view, **numbers)
        if isinstance(result, NodeView):
            raise ProblemError(
                f"{where}: the function returned a group - got a group of quantities, expected numbers; name one of "
                "them"
            )
        try:
            rows = column(result)
        except NotImplementedError as error:
            raise ProblemError(
                f"{where}: the function's result is unusable - got {type(result).__name__}, expected a CasADi column; "
                "return one"
            ) from error
        if rows.numel() == 0:
            raise ShapeError(f"{where}: the function returned no rows - got 0, expected at least one; return some")
        self.check_symbols(where, rows)
        return cs.densify(rows)

    def bind_cost(self, view: NodeView, dynamics: Dynamics, index: int, cost: Cost) -> _Piece:
        """Return a cost's rows."""
        if cost.quantity is not None:
            bound = dynamics.quantities.bind(cost.quantity)
            rows, labels, mask = self.difference(bound, index, cost), bound.labels, bound.mask
            unit, rotates = cost.unit or bound.quantity.unit, bound.quantity.kind == "rotation"
        else:
            rows = self.evaluate(view, index, cost.function)
            labels = tuple(str(i) for i in range(rows.numel())) if rows.numel() > 1 else ("",)
            mask, unit, rotates = None, cost.unit, False
        if cost.mask is not None:
            extra = self.stretch(
                self.evaluate(view, index, cost.mask, is_mask=True), rows.numel(), f"term '{cost.name}' ({cost.source})"
            )
            mask = extra if mask is None else mask * extra
        weight = self.own(f"term{index}.weight", rows.numel())
        names = tuple(Row(index, label, unit, rotates=rotates) for label in labels)
        return _Piece(rows, weight, cs.SX.ones(rows.numel()) if mask is None else mask, names)

    def difference(self, bound: Bound, index: int, cost: Cost) -> cs.SX:
        """Return value ⊖ target of a tracked quantity."""
        if cost.target is not None and cost.target.size == 0 and bound.quantity.kind != "rotation":
            return bound.value
        target = self.own(f"term{index}.target", bound.value.numel())
        if bound.quantity.kind == "rotation":
            return rotation.log(rotation.multiply(rotation.conjugate(target), bound.value))
        return bound.value - target

    def stretch(self, mask: cs.SX, count: int, where: str) -> cs.SX:
        """Return a mask with one entry per row; a mask of fewer entries is repeated blockwise."""
        if count % mask.numel():
            raise ShapeError(
                f"{where}: mask has the wrong size - got {mask.numel()} entries, expected a divisor of {count} rows; "
                "mend it"
            )
        if cs.depends_on(mask, cs.vertcat(self.x, self.u, self.z)):
            raise ProblemError(
                f"{where}: mask depends on state or control - got an expression of x, u or z, expected numbers of the "
                "node (contact flags); mend it"
            )
        return cs.kron(mask, cs.SX.ones(count // mask.numel()))

    def bind_constraint(self, view: NodeView, index: int, constraint: Constraint) -> _Piece:
        """Return a constraint's rows: value − lower and upper − value, divided by its scale."""
        where = f"constraint '{constraint.name}' ({constraint.source})"
        value = self.evaluate(view, index, constraint.function)
        n = value.numel()
        labels = constraint.labels(self.model) if callable(constraint.labels) else constraint.labels
        labels = tuple(labels) if labels is not None else tuple(str(i) for i in range(n)) if n > 1 else ("",)
        if len(labels) != n:
            raise ShapeError(
                f"{where}: labels do not match the rows - got {len(labels)}, expected {n}; give one per row"
            )
        mask = cs.SX.ones(n) * self.own(f"term{index}.active", 1)
        if constraint.mask is not None:
            mask = mask * self.stretch(self.evaluate(view, index, constraint.mask, is_mask=True), n, where)
        unit, scale = constraint.unit, constraint.scale
        if constraint.kind == "equality":
            return _Piece(value / scale, None, mask, tuple(Row(index, x, unit, scale) for x in labels))
        rows, masks, names = [], [], []
        for side, sign in (("lower", 1), ("upper", -1)):
            if getattr(constraint, side) is None:
                continue
            bound = self.own(f"term{index}.{side}", n)
            finite = self.own(f"term{index}.has_{side}", n)
            rows.append(sign * (value - bound) / scale)
            masks.append(mask * finite)
            names += [Row(index, x, unit, scale, side) for x in labels]
        return _Piece(cs.vertcat(*rows), None, cs.vertcat(*masks), tuple(names))

    # ---- everything together

    def build(self) -> LoweredMode:
        """Return the lowered mode."""
        p_model = self.model_slots()
        dynamics = self.model.dynamics(self.key, self.x, self.u, self.z, p_model)
        declared = getattr(self.model, "source", None)
        where = f"model '{self.model.name}'{f' ({declared})' if declared else ''}, mode '{self.key}'"
        self.check_symbols(where, cs.vertcat(dynamics.implicit, dynamics.next_state))
        view = NodeView(dynamics.quantities)
        stage: dict[str, list[_Piece]] = {"residual": [], "g": [], "h": []}
        terminal: dict[str, list[_Piece]] = {"residual": [], "g": [], "h": []}
        bound: list[int] = []
        for index, term in enumerate(self.terms):
            if index in self.excluded:
                self.unbound[index] = LEFT_OUT
                continue
            try:
                if isinstance(term, Cost):
                    group, piece = "residual", self.bind_cost(view, dynamics, index, term)
                else:
                    group, piece = "g" if term.kind == "inequality" else "h", self.bind_constraint(view, index, term)
            except UnknownNameError as error:
                self.unbound[index] = _cannot(self.model, error)
                continue
            bound.append(index)
            needs = cs.depends_on(piece.rows, cs.vertcat(self.u, self.z)) if self.u.numel() + self.z.numel() else False
            if term.at != "running" and needs:
                raise ProblemError(
                    f"term '{term.name}' ({term.source}): depends on control or contact force where there is none - "
                    f"got at='{term.at}', expected at='running' or an expression of the state; change one"
                )
            if term.at == "running":
                stage[group].append(piece)
            if term.at != "running" or (group != "residual" and not needs):
                terminal[group].append(piece)
        switching = self.model.switching(self.key, dynamics.quantities, p_model)
        if switching is not None:
            mask = cs.SX.ones(switching.size) if switching.mask is None else switching.mask
            rows = tuple(Row(-1, label, switching.quantity.unit) for label in switching.labels)
            terminal["h"].append(_Piece(switching.value, None, mask, rows))
        layout = Layout((name, symbol.numel()) for name, symbol in self.slots.items())
        p = cs.vertcat(*self.slots.values())
        return LoweredMode(
            model=self.model,
            key=self.key,
            layout=layout,
            parameters=tuple(self.parameters.values()),
            nz=self.z.numel(),
            functions=self.make_functions(dynamics, stage, terminal, p),
            rows={f"stage_{k}": _rows(v) for k, v in stage.items()}
            | {f"terminal_{k}": _rows(v) for k, v in terminal.items()},
            outputs=tuple((q, dynamics.quantities.bind(q).value.numel()) for q in dynamics.outputs),
            bound=tuple(bound),
            unbound=self.unbound,
        )

    def make_functions(
        self, dynamics: Dynamics, stage: dict[str, list[_Piece]], terminal: dict[str, list[_Piece]], p: cs.SX
    ) -> dict[str, cs.Function]:
        """Return the mode's functions, named after the table above."""
        x, u, z = self.x, self.u, self.z
        rows = {k: _stack([piece.rows for piece in v]) for k, v in stage.items()}
        end = {k: _stack([piece.rows for piece in v]) for k, v in terminal.items()}
        outputs = _stack([dynamics.quantities.bind(q).value for q in dynamics.outputs])
        weights = [
            _stack([i.weight * i.mask for i in group["residual"] if i.weight is not None])
            for group in (stage, terminal)
        ]
        masks = [[_stack([i.mask for i in group[k]]) for k in ("g", "h")] for group in (stage, terminal)]
        xuzp = {"x": x, "u": u, "z": z, "p": p}
        step = {"x_next": dynamics.next_state} if self.model.has_derivatives else {}
        return {
            "stage": make_function("stage", xuzp, {**step, **rows}),
            "stage_w": make_function(
                "stage_w", {"p": p}, {"weight": weights[0], "g_mask": masks[0][0], "h_mask": masks[0][1]}
            ),
            "terminal": make_function("terminal", {"x": x, "p": p}, end),
            "terminal_w": make_function(
                "terminal_w", {"p": p}, {"weight": weights[1], "g_mask": masks[1][0], "h_mask": masks[1][1]}
            ),
            "outputs": make_function("outputs", xuzp, {"outputs": outputs}),
        } | (self.derivatives(dynamics, rows, end, p) if self.model.has_derivatives else {})

    def derivatives(
        self, dynamics: Dynamics, rows: dict[str, cs.SX], end: dict[str, cs.SX], p: cs.SX
    ) -> dict[str, cs.Function]:
        """Return the implicit part and the derivatives of dynamics and rows."""
        x, u, z, state = self.x, self.u, self.z, self.model.state
        K, r0 = affine(dynamics.implicit, z, f"model '{self.model.name}', mode '{self.key}'")
        xn, dx = cs.SX.sym("xn", state.nx), cs.SX.sym("dx", state.ndx)
        # Derivatives by the tangent go through x + E(x) dx at dx = 0; least squares need no second ones (Gauss-Newton).
        groups = [dynamics.implicit, state.minus(dynamics.next_state, xn), rows["residual"], rows["g"], rows["h"]]
        by_w, by_z = tangent_jacobians(groups, state, x, dx, u, z)
        end_by_x, _ = tangent_jacobians(list(end.values()), state, x, dx, cs.SX(0, 1), cs.SX(0, 1))
        names = ["residual", "g", "h"]
        stage = {"x": x, "u": u, "z": z, "p": p, "xn": xn}
        others = dict(zip(["d_w", *(f"{n}_w" for n in names)], by_w[1:], strict=True))
        others |= dict(zip(["d_z", *(f"{n}_z" for n in names)], by_z[1:], strict=True))
        by_u = cs.horzcat(cs.SX(z.numel(), state.ndx), by_w[0][:, state.ndx :])
        smooth = is_smooth(cs.Function("implicit", [x, u, z, p], [dynamics.implicit]))
        return {
            "implicit": make_derivatives("implicit", {"x": x, "u": u, "p": p}, {"K": K}, {"r0": r0}),
            "stage_d": make_derivatives("stage_d", stage, {"r_w": by_w[0], **others}),
            "guess_d": make_derivatives("guess_d", stage, {"r_w": by_u if smooth else by_w[0], **others}),
            "terminal_d": make_derivatives(
                "terminal_d", {"x": x, "p": p}, {f"{n}_x": j for n, j in zip(names, end_by_x, strict=True)}
            ),
        }


def _cannot(model: ModelBase, error: UnknownNameError) -> str:
    """Return why a model cannot supply what a term speaks of."""
    if error.what == "component":
        return f"{error.where} of model '{model.name}' has no component '{error.name}'{error.hint}"
    return f"model '{model.name}' cannot supply '{error.name}'{error.hint}"


def _rows(pieces: list[_Piece]) -> tuple[Row, ...]:
    return tuple(row for piece in pieces for row in piece.labels)


def _stack(parts: list[cs.SX]) -> cs.SX:
    return cs.vertcat(*parts) if parts else cs.SX(0, 1)
