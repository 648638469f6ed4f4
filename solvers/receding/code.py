"""The compiled code of one or several horizons: one library of the solver, and one of ticks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import Horizon, LoweredMode, LoweredTransition

from ..ilqr import library_of, sizes_header
from .functions import generated_functions
from .plan import followed_modes
from .program import receding_library

Array = NDArray[np.float64]


class HorizonCode:
    """The libraries of horizons that are planned in turn, and the commands that their references read.

    What several horizons have in common is compiled once: modes, transitions, and functions that are equal.

    Args:
        horizons: the problems at any time.
        more: numbers before the commands of the first horizon.

    Attributes:
        modes, links: the modes and transitions, in the order of their numbers in the solver.
        followed: the modes that low levels follow, in the order of their numbers there.
        solver, library: the libraries; width: doubles per vector of both.
        functions: the generated functions, by name. work: the size of the work array of each.
        names: per horizon, name of a function there → name in the library.
        commands: what C reads; firsts: per horizon, the place of its commands.
    """

    def __init__(self, horizons: Sequence[Horizon], more: int = 0) -> None:
        every = [(each.tables.modes, each.tables.transitions) for each in horizons]
        self.modes = tuple(dict.fromkeys(
            store.lowered for modes, _ in every for store in modes if isinstance(store.lowered, LoweredMode)
        ))  # fmt: skip
        self.links = tuple(dict.fromkeys(
            store.lowered for _, links in every for store in links if isinstance(store.lowered, LoweredTransition)
        ))  # fmt: skip
        self.followed = tuple(dict.fromkeys(mode for each in horizons for mode in followed_modes(each)))
        self.solver, _ = library_of(self.modes, self.links)
        self.width = self.solver.built.width
        self.functions, self.names = _merged([generated_functions(each) for each in horizons])
        self.library, self.work = receding_library(tuple(self.functions.items()), self.width, sizes_header(self.modes))
        own = [commanded(each, {}) for each in horizons]
        self.firsts = [more + sum(len(values) for values in own[:i]) for i in range(len(own))]
        self.commands: Array = np.concatenate([np.zeros(more), *own])


def commanded(horizon: Horizon, commands: Mapping[str, float]) -> Array:
    """Return the commands of all pieces of a horizon in turn: values by name, else the declared ones."""
    pieces = (each for each in horizon.courses.pieces if each.functions is not None)
    return np.concatenate([np.zeros(0), *(piece.commanded(commands) for piece in pieces)])


def _merged(given: Sequence[Mapping[str, cs.Function]]) -> tuple[dict[str, cs.Function], list[dict[str, str]]]:
    """Return the functions of all horizons by name, equal ones of several horizons once, and the names per horizon."""
    if len(given) == 1:
        return dict(given[0]), [{name: name for name in given[0]}]
    found: dict[str, cs.Function] = {}
    known: dict[str, str] = {}
    names: list[dict[str, str]] = []
    for number, functions in enumerate(given):
        own = {}
        for name, function in functions.items():
            text = function.serialize()
            if text not in known:
                known[text] = name if name not in found else f"{name}_of{number}"
                found[known[text]] = function
            own[name] = known[text]
        names.append(own)
    return found, names
