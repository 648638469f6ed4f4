"""Lowered modes: one mode of a model and its bound terms, as CasADi functions.

The functions of a mode, with w = (δx, u) and d = f ⊖ x_next; derivatives are those at x ⊕ δx with δx = 0:

=============  ============================================  ====================================================
implicit       (x, u, p)         → K, r0                     the implicit part r = r0 + K z, z = −K⁻¹ r0
stage          (x, u, z, p)      → x_next, residual, g, h    one stage; rows of running terms
stage_d        (x, u, z, p, xn)  → r_w, and d, residual, g,
                                   h by w and by z
split_d        (x, u, z, p, xn)  → first_w, first_z, finish  of a step in parts: d_w = finish first_w, d_z likewise
guess_d        as stage_d        → as stage_d                r_w by x is zero if it is finite wherever x, u, z are
stage_w        (p)               → weight, g_mask, h_mask    numbers per row; a row with mask 0 has no effect
terminal       (x, p)            → residual, g, h            the last node of a phase
terminal_d     (x, p)            → residual_x, g_x, h_x
terminal_w     (p)               → weight, g_mask, h_mask
outputs        (x, u, z, p)      → recorded quantities
=============  ============================================  ====================================================

Inequalities are g ≥ 0. Inequalities and equalities are divided by the row's scale. A mode of a model without
derivatives has no implicit, stage_d, guess_d, terminal_d and no x_next: the simulator makes its step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from ..language import Manifold, ModelBase, Parameter, Quantity
from .layout import Layout


@dataclass(frozen=True)
class Row:
    """One row of a residual or constraint.

    Args:
        term: index into the problem's terms; -1 for rows that the model derives (switching).
        label: name of the component.
        unit: its unit.
        scale: divisor of the value in SI units.
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
    """A mode's functions, sizes, rows and parameter layout.

    Args:
        model: the model.
        key: the mode.
        layout: the positions of parameters.
        parameters: the user's among them.
        nz: size of the implicit part.
        functions: see the table above.
        rows: per function and kind the rows: ``stage_residual``, ``terminal_g`` and so on.
        outputs: recorded quantities and their sizes.
        bound: indices of the terms with rows in this mode.
        unbound: why the other terms have none.
        at_reset: indices of the terms with rows at the model's own reset, see :class:`LoweredTransition`.
        output_labels: per recorded quantity the names of its components.
    """

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
    at_reset: tuple[int, ...] = ()
    output_labels: tuple[tuple[str, ...], ...] = ()

    @property
    def state(self) -> Manifold:
        """The state space."""
        return self.model.state

    @cached_property
    def state_sizes(self) -> NDArray[np.float64]:
        """The natural size of each component of a difference of two states, (ndx,)."""
        return self.model.sizes.of_space(self.model.state)

    @cached_property
    def control_sizes(self) -> NDArray[np.float64]:
        """The natural size of each control, (nu,)."""
        return self.model.sizes.of_space(self.model.control)

    @property
    def residuals(self) -> tuple[Row, ...]:
        """The rows of all costs, each term's once."""
        return self.rows["stage_residual"] + self.rows["terminal_residual"]

    @property
    def nu(self) -> int:
        """Number of controls."""
        return self.model.control.nx
