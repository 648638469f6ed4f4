"""The invariants of a mode as expressions of its state and parameters."""

from __future__ import annotations

import casadi as cs

from ..language import Invariants
from .mode import LoweredMode


def bound_invariants(mode: LoweredMode) -> tuple[cs.SX, cs.SX, Invariants]:
    """Return the symbols of state (nx,) and parameters (np,), and the invariants of a mode as expressions of them."""
    model = mode.model
    x, u, z = (
        cs.SX.sym(name, size)
        for name, size in (("x", model.state.nx), ("u", model.control.nx), ("z", model.implicit_size(mode.key)))
    )
    p = cs.SX.sym("p", mode.layout.size)
    of_model = mode.layout.of_model(p)
    return x, p, model.invariants(mode.key, model.dynamics(mode.key, x, u, z, of_model).quantities, of_model)
