"""Transitions: the change of the state between two phases - impact, the user's reset, projection to the next model.

Functions of a transition, from the state x at the end of a phase to the first state of the next:

=========  ===================  ==================================================
implicit   (x, p)         → K, r0   the impact's implicit part, z = −K⁻¹ r0
reset      (x, z, p)      → x_next
reset_d    (x, z, p, xn)  → r_x, d_x, d_z   with d = reset ⊖ xn
=========  ===================  ==================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as cs

from piaffe.errors import ProblemError, ShapeError

from ..language import ModelBase, NodeView, Parameter, ResetMap, call, column
from .functions import make_derivatives, make_function
from .layout import Layout
from .linear import affine, tangent_jacobians
from .symbols import NodeSymbols


@dataclass(frozen=True, eq=False)
class LoweredTransition:
    """A transition's functions and parameter layout."""

    source: ModelBase
    key: str
    target: ModelBase
    layout: Layout
    parameters: tuple[Parameter, ...]
    nz: int
    functions: Mapping[str, cs.Function]


def lower_transition(
    source: ModelBase, key: str, target: ModelBase, user: ResetMap | None, where: str
) -> LoweredTransition:
    """Return the lowered transition between two models.

    Args:
        source: the model before the transition.
        key: its mode.
        target: the model after the transition.
        user: the phase's own reset map, applied after the model's.
        where: both phases, for messages.
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
    p = symbols.p
    return LoweredTransition(
        source=source,
        key=key,
        target=target,
        layout=symbols.layout,
        parameters=symbols.parameters,
        nz=z.numel(),
        functions={
            "implicit": make_derivatives("implicit", {"x": x, "p": p}, {"K": K}, {"r0": r0}),
            "reset": make_function("reset", {"x": x, "z": z, "p": p}, {"x_next": x_next}),
            "reset_d": make_derivatives(
                "reset_d", {"x": x, "z": z, "p": p, "xn": xn}, {"r_x": by_x[0], "d_x": by_x[1], "d_z": by_z[1]}
            ),
        },
    )
