"""Lowering: from a model's mode and a problem's terms to the functions of a :class:`LoweredMode`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from functools import cache, partial

import casadi as cs

from piaffe.errors import ProblemError, UnknownNameError
from piaffe.interrupts import check_interrupt

from ..language import Constraint, Cost, Dynamics, ModelBase
from .functions import is_smooth, make_derivatives, make_function
from .groups import Groups, cannot, group_of, names_of, numbers_of_rows, stacked
from .linear import affine, split_jacobians, tangent_jacobians
from .mode import LoweredMode, Row
from .rows import Rows, TermBinder
from .symbols import NodeSymbols

LEFT_OUT = "left out by the schedule"


def lower_mode(model: ModelBase, key: str, terms: Sequence[Cost | Constraint], excluded: Set[int]) -> LoweredMode:
    """Return the lowered mode.

    Args:
        model: the model.
        key: the mode.
        terms: the problem's terms.
        excluded: indices of the terms that the schedule leaves out.

    Raises:
        ProblemError, ShapeError: a term or the model is unusable; the message names the declaration.
    """
    symbols = NodeSymbols(model, model.implicit_size(key))
    x, u, z = symbols.x, symbols.u, symbols.z
    dynamics = model.dynamics(key, x, u, z, symbols.of_model())
    declared = getattr(model, "source", None)
    where = f"model '{model.name}'{f' ({declared})' if declared else ''}, mode '{key}'"
    symbols.check(where, cs.vertcat(dynamics.implicit, dynamics.next_state))
    binder = TermBinder(model, dynamics.quantities, symbols, terms)
    resets = cache(partial(_reset_quantities, model, key))
    stage: Groups = {"residual": [], "g": [], "h": []}
    terminal: Groups = {"residual": [], "g": [], "h": []}
    bound: list[int] = []
    unbound: dict[int, str] = {}
    at_reset: list[int] = []
    for index, term in enumerate(terms):
        check_interrupt()
        if index in excluded:
            unbound[index] = LEFT_OUT
            continue
        try:
            rows = binder.bind(index)
        except UnknownNameError as error:
            unbound[index] = cannot(model, error)
            if term.at == "phase_end" and error.name in resets():
                at_reset.append(index)
            continue
        bound.append(index)
        if isinstance(term, Constraint) and term.at_reset is not None and resets():
            at_reset.append(index)
        group = group_of(term)
        needs = cs.depends_on(rows.value, cs.vertcat(u, z)) if u.numel() + z.numel() else False
        if term.at != "running" and needs:
            raise ProblemError(
                f"term '{term.name}' ({term.source}): depends on control or contact force where there is none - "
                f"got at='{term.at}', expected at='running' or an expression of the state; change one"
            )
        if term.at == "running":
            stage[group].append(rows)
        if term.at != "running" or (group != "residual" and not needs):
            terminal[group].append(rows)
    switching = model.switching(key, dynamics.quantities, symbols.of_model())
    if switching is not None:
        mask = cs.SX.ones(switching.size) if switching.mask is None else switching.mask
        names = tuple(Row(-1, label, switching.quantity.unit, switching.scale) for label in switching.labels)
        terminal["h"].append(Rows(switching.value / switching.scale, None, mask, names))
    return LoweredMode(
        model=model,
        key=key,
        layout=symbols.layout,
        parameters=symbols.parameters,
        nz=z.numel(),
        functions=_functions(model, key, dynamics, symbols, stage, terminal),
        rows={f"stage_{k}": names_of(v) for k, v in stage.items()}
        | {f"terminal_{k}": names_of(v) for k, v in terminal.items()},
        outputs=tuple((q, dynamics.quantities.bind(q).value.numel()) for q in dynamics.outputs),
        output_labels=tuple(tuple(dynamics.quantities.bind(q).labels) for q in dynamics.outputs),
        bound=tuple(bound),
        unbound=unbound,
        at_reset=tuple(at_reset),
    )


def _functions(
    model: ModelBase, key: str, dynamics: Dynamics, symbols: NodeSymbols, stage: Groups, terminal: Groups
) -> Mapping[str, cs.Function]:
    """Return the mode's functions, with the names of the table in :mod:`.mode`."""
    x, p = symbols.x, symbols.p
    xuzp = {"x": x, "u": symbols.u, "z": symbols.z, "p": p}
    rows = {k: stacked([piece.value for piece in v]) for k, v in stage.items()}
    end = {k: stacked([piece.value for piece in v]) for k, v in terminal.items()}
    step = {"x_next": dynamics.next_state} if model.has_derivatives else {}
    return {
        "stage": make_function("stage", xuzp, {**step, **rows}),
        "stage_w": make_function("stage_w", {"p": p}, numbers_of_rows(stage)),
        "terminal": make_function("terminal", {"x": x, "p": p}, end),
        "terminal_w": make_function("terminal_w", {"p": p}, numbers_of_rows(terminal)),
        "outputs": make_function(
            "outputs", xuzp, {"outputs": stacked([dynamics.quantities.bind(q).value for q in dynamics.outputs])}
        ),
    } | (_derivatives(model, key, dynamics, symbols, rows, end) if model.has_derivatives else {})


def _derivatives(
    model: ModelBase, key: str, dynamics: Dynamics, symbols: NodeSymbols, rows: dict[str, cs.SX], end: dict[str, cs.SX]
) -> dict[str, cs.Function]:
    """Return the implicit part and the derivatives of dynamics and rows."""
    x, u, z, p, state = symbols.x, symbols.u, symbols.z, symbols.p, model.state
    where = f"model '{model.name}', mode '{key}'"
    K, r0 = affine(dynamics.implicit, z, where)
    xn, dx = cs.SX.sym("xn", state.nx), cs.SX.sym("dx", state.ndx)
    # Derivatives by the tangent are those of x + E(x) dx at dx = 0; Gauss-Newton needs no second derivatives.
    split = None if dynamics.split is None else split_jacobians(dynamics.split, state, x, xn, u, z, where)
    own = [cs.SX(0, 1)] * 2 if split else [dynamics.implicit, state.minus(dynamics.next_state, xn)]
    by_w, by_z = tangent_jacobians([*own, *rows.values()], state, x, dx, u, z)
    if split:
        by_w[:2], by_z[1] = [split.r_w, split.finish @ split.first_w], split.finish @ split.first_z
    end_by_x, _ = tangent_jacobians(list(end.values()), state, x, dx, cs.SX(0, 1), cs.SX(0, 1))
    names = ["residual", "g", "h"]
    stage = {"x": x, "u": u, "z": z, "p": p, "xn": xn}
    others = dict(zip(["d_w", *(f"{n}_w" for n in names)], by_w[1:], strict=True))
    others |= dict(zip(["d_z", *(f"{n}_z" for n in names)], by_z[1:], strict=True))
    by_u = cs.horzcat(cs.SX(z.numel(), state.ndx), by_w[0][:, state.ndx :])
    at, residual = (dynamics.split.middle, dynamics.split.residual) if dynamics.split else (x, dynamics.implicit)
    smooth = is_smooth(cs.Function("implicit", [at, u, z, p], [residual]))
    return {
        "implicit": make_derivatives("implicit", {"x": x, "u": u, "p": p}, {"K": K}, {"r0": r0}),
        "stage_d": make_derivatives("stage_d", stage, {"r_w": by_w[0], **others}),
        "guess_d": make_derivatives("guess_d", stage, {"r_w": by_u if smooth else by_w[0], **others}),
        "terminal_d": make_derivatives(
            "terminal_d", {"x": x, "p": p}, {f"{n}_x": j for n, j in zip(names, end_by_x, strict=True)}
        ),
    } | ({"split_d": make_derivatives("split_d", stage, split.of_defect)} if split else {})


def _reset_quantities(model: ModelBase, key: str) -> Set[str]:
    """Return the paths of the quantities at the model's own reset, which need not have a z."""
    symbols = NodeSymbols(model, model.reset_size(key))
    quantities = model.reset(key, symbols.x, symbols.z, symbols.of_model()).quantities
    return frozenset() if quantities is None else frozenset(quantities.paths)
