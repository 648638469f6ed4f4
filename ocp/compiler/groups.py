"""Groups of rows by kind: residuals of costs, inequalities g, equalities h; of modes and of transitions."""

from __future__ import annotations

import casadi as cs

from piaffe.errors import UnknownNameError

from ..language import Constraint, Cost, ModelBase
from .mode import Row
from .rows import Rows

Groups = dict[str, list[Rows]]

_FEW = 16  # at most this many names are listed


def group_of(term: Cost | Constraint) -> str:
    """Return the kind of a term's rows."""
    return "residual" if isinstance(term, Cost) else "g" if term.kind == "inequality" else "h"


def names_of(pieces: list[Rows]) -> tuple[Row, ...]:
    """Return the names of all rows."""
    return tuple(row for piece in pieces for row in piece.names)


def numbers_of_rows(groups: Groups) -> dict[str, cs.SX]:
    """Return weights of residuals and masks of constraints."""
    weights = [piece.weight * piece.mask for piece in groups["residual"] if piece.weight is not None]
    return {"weight": stacked(weights)} | {
        f"{k}_mask": stacked([piece.mask for piece in groups[k]]) for k in ("g", "h")
    }


def stacked(parts: list[cs.SX]) -> cs.SX:
    """Return columns as one column."""
    return cs.vertcat(*parts) if parts else cs.SX(0, 1)


def cannot(model: ModelBase, error: UnknownNameError) -> str:
    """Return why a model cannot supply the quantities of a term."""
    if error.what == "component":
        has = f" (it has {', '.join(error.known)})" if len(error.known) <= _FEW else ""
        return f"{error.where} of model '{model.name}' has no component '{error.name}'{error.hint or has}"
    return f"model '{model.name}' cannot supply '{error.name}'{error.hint}"
