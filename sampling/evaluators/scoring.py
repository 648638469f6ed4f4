"""Scoring: the cost of a stage of a lowered mode and the violation of each constraint, as two functions.

===========  =======================================================  ==============================
stage        (x, u, z, p, weight, g_mask, h_mask)                     → cost (1), violation (nc,)
terminal     (x, p, weight, g_mask, h_mask)                           → cost (1), violation (nc_end,)
===========  =======================================================  ==============================

The cost is ½ Σ wᵢ rᵢ² over the residual's rows; for a stage it is per unit of time, not multiplied by dt. A violation
is max(−g, 0) for an inequality and |h| for an equality, times the row's mask; g and h are already divided by the row's
scale. Inequalities come first. The expressions are those of the mode's own functions, which solvers differentiate, too.

If a state is NaN, the cost is NaN and violations are zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as cs

from piaffe.ocp import Constraint, Cost, LoweredMode, Row


@dataclass(frozen=True, eq=False)
class Scoring:
    """The two functions of a mode, and descriptions of the rows of their violations.

    Args:
        mode: the lowered mode.
        stage: cost and violation of a stage.
        terminal: cost and violation of the last node.
        rows: description of each row of a stage's violation, inequalities first.
        end_rows: the same for the last node.
    """

    mode: LoweredMode
    stage: cs.Function
    terminal: cs.Function
    rows: tuple[Row, ...]
    end_rows: tuple[Row, ...]

    def constraints(self, terms: Sequence[Cost | Constraint]) -> tuple[str, ...]:
        """Return the name of the constraint that each row of a stage's violation belongs to, (nc,).

        Args:
            terms: the problem's terms, ``CompiledProblem.terms``.
        """
        return tuple(_constraint(terms, row) for row in self.rows)

    def names(self, terms: Sequence[Cost | Constraint]) -> tuple[str, ...]:
        """Return the full name of each row of a stage's violation: constraint, component and side, (nc,)."""
        return tuple(_name(terms, row) for row in self.rows)

    def end_names(self, terms: Sequence[Cost | Constraint]) -> tuple[str, ...]:
        """Return the full name of each row of the last node's violation, (nc_end,)."""
        return tuple(_name(terms, row) for row in self.end_rows)


@lru_cache(maxsize=64)
def scoring(mode: LoweredMode) -> Scoring:
    """Return the scoring of a lowered mode; the same object in every call with the same mode.

    Args:
        mode: the lowered mode of any model, with derivatives or without.
    """
    rows = mode.rows
    return Scoring(
        mode,
        _scored(mode.functions["stage"]),
        _scored(mode.functions["terminal"]),
        (*rows["stage_g"], *rows["stage_h"]),
        (*rows["terminal_g"], *rows["terminal_h"]),
    )


def _scored(function: cs.Function) -> cs.Function:
    """Return cost and violation as a function, from one with the outputs residual, g and h."""
    inputs = {name: cs.SX.sym(name, function.size1_in(name)) for name in function.name_in()}
    values = dict(zip(function.name_out(), function.call(list(inputs.values())), strict=True))
    residual, g, h = (values[name] for name in ("residual", "g", "h"))
    weight, g_mask, h_mask = (
        cs.SX.sym(name, rows.numel()) for name, rows in (("weight", residual), ("g_mask", g), ("h_mask", h))
    )
    cost = 0.5 * cs.sum1(weight * residual**2) if residual.numel() else cs.SX(0.0)
    violation = cs.vertcat(cs.fmax(-g, 0) * g_mask, cs.fmax(cs.fabs(h), 0) * h_mask)
    inputs |= {"weight": weight, "g_mask": g_mask, "h_mask": h_mask}
    return cs.Function(
        function.name(),
        list(inputs.values()),
        [cs.densify(cost), cs.densify(violation)],
        list(inputs),
        ["cost", "violation"],
        {"cse": True},
    )


def _constraint(terms: Sequence[Cost | Constraint], row: Row) -> str:
    return "switching" if row.term < 0 else terms[row.term].name


def _name(terms: Sequence[Cost | Constraint], row: Row) -> str:
    return " ".join(part for part in (_constraint(terms, row), row.label, row.side) if part)
