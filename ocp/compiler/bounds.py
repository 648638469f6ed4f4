"""Check of constraints' bounds among the parameters: no lower bound exceeds its upper bound."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError

from ..language import Constraint, Cost, ParameterKey
from .mode import LoweredMode
from .transition import LoweredTransition


def check_bounds(
    mode: LoweredMode | LoweredTransition,
    terms: Sequence[Cost | Constraint],
    p: NDArray[np.float64],
    place: Callable[[int], object] | None = None,
) -> None:
    """Raise if the bounds of a constraint exclude each other.

    Args:
        mode: the mode or transition, for its layout.
        terms: the problem's terms.
        p: parameters of nodes (n, np).
        place: function of a row of ``p`` that says where it is, for messages; None if all nodes have these bounds.
    """
    slices = mode.layout.slices
    for k in mode.bound:
        lower, upper = ParameterKey("lower", term=k), ParameterKey("upper", term=k)
        if lower not in slices or upper not in slices:
            continue
        both = p[:, slices[lower.has_bound]] * p[:, slices[upper.has_bound]]
        least, most = p[:, slices[lower]], p[:, slices[upper]]
        wrong = np.argwhere((both > 0) & (least > most))
        if wrong.size:
            node, row = (int(i) for i in wrong[0])
            term = terms[k]
            at = "" if place is None else f", {place(node)}"
            raise ProblemError(
                f"{term.where}, model '{mode.model.name}', row {row}{at}: bounds exclude each other - got lower "
                f"{least[node, row]:g} above upper {most[node, row]:g} [{term.unit or '-'}], expected lower ≤ upper; "
                "swap them"
            )
