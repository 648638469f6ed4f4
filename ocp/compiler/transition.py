"""Transitions: the change of the state between two phases - impact, the user's reset, projection to the next model.

Functions of a transition, from the state x at the end of a phase to the first state of the next:

=========  ===================  ==================================================
implicit   (x, p)         → K, r0   the impact's implicit part, z = −K⁻¹ r0
reset      (x, z, p)      → x_next
reset_d    (x, z, p, xn)  → r_x, d_x, d_z   with d = reset ⊖ xn
rows       (x, z, p)      → residual, g, h  the rows of terms that need z (impulses)
rows_d     (x, z, p)      → the same by x and by z
rows_w     (p)            → weight, g_mask, h_mask
outputs    (x, z, p)      → recorded quantities
=========  ===================  ==================================================

The rows are rows of the last node before the reset. They are not part of the mode's, because the reset has the implicit
variables on which they depend, with z_x = −K⁻¹ r_x.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as cs

from piaffe.errors import ProblemError, ShapeError, UnknownNameError

from ..language import (
    Constraint,
    Cost,
    ModelBase,
    NodeView,
    Parameter,
    Quantity,
    Reset,
    ResetMap,
    call,
    column,
)
from .functions import make_derivatives, make_function
from .groups import Groups, cannot, group_of, names_of, numbers_of_rows, stacked
from .layout import Layout
from .linear import affine, tangent_jacobians
from .mode import Row
from .rows import TermBinder
from .symbols import NodeSymbols


@dataclass(frozen=True, eq=False)
class LoweredTransition:
    """A transition's functions, rows and parameter layout.

    Args:
        source: the model before it.
        key: its mode.
        target: the model after it.
        layout: the positions of parameters.
        parameters: the user's among them.
        nz: size of the implicit part.
        functions: see the table above.
        rows: the rows by kind: ``residual``, ``g``, ``h``.
        outputs: recorded quantities and their sizes.
        output_labels: per recorded quantity the names of its components.
        bound: indices of the terms with rows here.
        unbound: why other terms, which only a reset can have, have none.
    """

    source: ModelBase
    key: str
    target: ModelBase
    layout: Layout
    parameters: tuple[Parameter, ...]
    nz: int
    functions: Mapping[str, cs.Function]
    rows: Mapping[str, tuple[Row, ...]]
    outputs: tuple[tuple[Quantity, int], ...]
    output_labels: tuple[tuple[str, ...], ...]
    bound: tuple[int, ...]
    unbound: Mapping[int, str]

    @property
    def model(self) -> ModelBase:
        """The model whose state, quantities and numbers its rows depend on."""
        return self.source

    @property
    def residuals(self) -> tuple[Row, ...]:
        """The rows of all costs."""
        return self.rows["residual"]

    @property
    def num_rows(self) -> int:
        """Number of rows of all kinds."""
        return sum(map(len, self.rows.values()))


def lower_transition(
    source: ModelBase,
    key: str,
    target: ModelBase,
    user: ResetMap | None,
    where: str,
    terms: Sequence[Cost | Constraint] = (),
    at_reset: Sequence[int] = (),
) -> LoweredTransition:
    """Return the lowered transition between two models.

    Args:
        source: the model before the transition.
        key: its mode.
        target: the model after the transition.
        user: the phase's own reset map, applied after the model's.
        where: both phases, for messages.
        terms: the problem's terms.
        at_reset: indices of those that may have rows at the model's own reset.
    """
    symbols = NodeSymbols(source, source.reset_size(key))
    x, z, p_model = symbols.x, symbols.z, symbols.of_model()
    own = source.reset(key, x, z, p_model)
    absent = cs.vertcat(symbols.u, cs.SX.sym("z", source.implicit_size(key)))  # a phase's end has no u and no z
    dynamics = source.dynamics(key, x, symbols.u, absent[symbols.u.numel() :], p_model)
    returned: dict[str, cs.SX] = {}
    if user is not None:
        result = call(user.function, f"{where}, reset ({user.source})", NodeView(dynamics.quantities))
        if not isinstance(result, Mapping):
            raise ProblemError(
                f"{where}, reset ({user.source}): result is unusable - got {type(result).__name__}, expected a mapping "
                "of state names; return a dict"
            )
        returned = {name: column(value) for name, value in result.items()}
    parts = []
    for block in target.state.blocks:
        path = block.quantity.path
        if path in returned:
            value = returned.pop(path)
            if value.numel() != block.nx:
                raise ShapeError(
                    f"{where}, reset ({user.source if user else ''}): '{path}' has the wrong size for the next model "
                    f"'{target.name}' - got {value.numel()}, expected {block.nx} [{block.quantity.unit}]; return "
                    f"{block.nx}"
                )
            symbols.check(f"{where}, reset ({user.source if user else ''})", value, absent)
        elif path in dynamics.quantities and dynamics.quantities.bind(path).value.numel() == block.nx:
            value = dynamics.quantities.bind(path).value
        else:
            raise ShapeError(
                f"{where}: the next model '{target.name}' has a state that '{source.name}' does not supply - got no "
                f"'{path}', expected {block.nx} entries [{block.quantity.unit}]; return it from a reset map on the "
                "phase"
            )
        parts.append(value)
    if returned:
        names = [b.quantity.path for b in target.state.blocks]
        raise ProblemError(
            f"{where}, reset ({user.source if user else ''}): unknown state names - got {sorted(returned)}, expected "
            f"some of {names}; rename them"
        )
    x_next = cs.substitute(cs.vertcat(*parts), x, own.next_state)
    K, r0 = affine(own.implicit, z, where)
    xn, dx = cs.SX.sym("xn", target.state.nx), cs.SX.sym("dx", source.state.ndx)
    groups = [own.implicit, target.state.minus(x_next, xn)]
    by_x, by_z = tangent_jacobians(groups, source.state, x, dx, cs.SX(0, 1), z)
    rows, unbound = _bind(own, symbols, source, terms, at_reset)
    recorded = [] if own.quantities is None else [own.quantities.bind(quantity) for quantity in own.outputs]
    xzp = {"x": x, "z": z, "p": symbols.p}
    return LoweredTransition(
        source=source,
        key=key,
        target=target,
        layout=symbols.layout,
        parameters=symbols.parameters,
        nz=z.numel(),
        functions={
            "implicit": make_derivatives("implicit", {"x": x, "p": symbols.p}, {"K": K}, {"r0": r0}),
            "reset": make_function("reset", xzp, {"x_next": x_next}),
            "reset_d": make_derivatives("reset_d", {**xzp, "xn": xn}, {"r_x": by_x[0], "d_x": by_x[1], "d_z": by_z[1]}),
            **_rows_functions(rows, source, xzp),
            "outputs": make_function("outputs", xzp, {"outputs": stacked([each.value for each in recorded])}),
        },
        rows={kind: names_of(pieces) for kind, pieces in rows.items()},
        outputs=tuple((each.quantity, each.value.numel()) for each in recorded),
        output_labels=tuple(tuple(each.labels) for each in recorded),
        bound=tuple(k for k in at_reset if k not in unbound),
        unbound=unbound,
    )


def _bind(
    own: Reset, symbols: NodeSymbols, source: ModelBase, terms: Sequence[Cost | Constraint], at_reset: Sequence[int]
) -> tuple[Groups, dict[int, str]]:
    """Return the rows of terms at a reset by kind, and why some terms have none."""
    groups: Groups = {"residual": [], "g": [], "h": []}
    unbound: dict[int, str] = {}
    if own.quantities is None:
        return groups, unbound
    binder = TermBinder(source, own.quantities, symbols, terms)
    for index in at_reset:
        try:
            groups[group_of(terms[index])].append(binder.bind_at_reset(index))
        except UnknownNameError as error:
            unbound[index] = cannot(source, error)
    return groups, unbound


def _rows_functions(groups: Groups, source: ModelBase, xzp: Mapping[str, cs.SX]) -> dict[str, cs.Function]:
    """Return the functions of the rows at a reset."""
    x, z = xzp["x"], xzp["z"]
    values = {kind: stacked([piece.value for piece in pieces]) for kind, pieces in groups.items()}
    dx = cs.SX.sym("dx", source.state.ndx)
    by_x, by_z = tangent_jacobians(list(values.values()), source.state, x, dx, cs.SX(0, 1), z)
    matrices = {f"{kind}_x": J for kind, J in zip(values, by_x, strict=True)}
    matrices |= {f"{kind}_z": J for kind, J in zip(values, by_z, strict=True)}
    return {
        "rows": make_function("rows", dict(xzp), values),
        "rows_d": make_derivatives("rows_d", dict(xzp), matrices),
        "rows_w": make_function("rows_w", {"p": xzp["p"]}, numbers_of_rows(groups)),
    }
