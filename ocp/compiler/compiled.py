"""The compiled problem: flat phases of numbers and functions, the interface between language and solvers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import renamed_members
from piaffe.html import html_table

from ..language import Constraint, Cost, ParameterKey, Path, Phase, Source, caller, initial_state, merged
from .compiled_phase import CompiledPhase
from .mode import Row
from .parameters import Parameters
from .renumbered import renumbered

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class CompiledProblem:
    """Flat phases, the initial state, and the terms of their rows.

    Args:
        phases: the phases, in the order of time.
        initial: initial state (nx,).
        terms: costs and constraints; rows refer to them by index.
        scopes: per term the motion phase that declares it; None for terms of the whole problem.
        path: the targets over time.
        unbound: per (model name, term index) why a term is not in that model.
        changing: slots of models whose values follow from the motion at each node, and bounds that vary over a phase.
        lowered: number of modes and transitions that were built for this problem; 0 if all were in the cache.
        compile_s: time spent compiling [s].
        source: where the problem was declared.
    """

    phases: tuple[CompiledPhase, ...]
    initial: Array
    terms: tuple[Cost | Constraint, ...]
    scopes: tuple[Phase | None, ...]
    path: Path
    unbound: Mapping[tuple[str, int], str]
    changing: frozenset[ParameterKey]
    lowered: int
    compile_s: float
    source: Source = field(default_factory=caller)

    def __repr__(self) -> str:
        models = ", ".join(dict.fromkeys(phase.mode.model.name for phase in self.phases))
        return (
            f"CompiledProblem({self.source}: {len(self.phases)} phases, {self.num_stages} stages of {models}; "
            f"{len(self.terms)} terms)"
        )

    def _repr_html_(self) -> str:
        head = (
            "phase",
            "mode",
            "model",
            "stages",
            "dt [s]",
            "states",
            "controls",
            "residuals",
            "inequalities",
            "equalities",
        )
        rows = [
            (
                p.name, p.label, p.mode.model.name, p.num_stages, p.dt, p.mode.state.nx, p.mode.nu, p.weight.shape[1],
                p.g_mask.shape[1], p.h_mask.shape[1],
            )
            for p in self.phases
        ]  # fmt: skip
        return html_table(repr(self), head, rows)

    @property
    def num_stages(self) -> int:
        """Stages of the whole horizon."""
        return sum(phase.num_stages for phase in self.phases)

    @cached_property
    def parameters(self) -> Parameters:
        """Every parameter by name, with its present value (size,)."""
        return Parameters(self.phases, self.terms, self.changing)

    def with_parameters(self, values: Mapping[str, ArrayLike] | None = None, /, **named: ArrayLike) -> CompiledProblem:
        """Return the problem with other values of some of its ``parameters``; nothing is compiled.

        The result is the compiled form of ``problem.with_parameters(...)``; :meth:`Problem.with_parameters` lists the
        names.

        Args:
            values: name → value, with as many entries as now; an infinite bound is no bound.
            named: the same as keywords, for names that are Python identifiers.

        Raises:
            UnknownNameError: there is no such parameter; the message lists those that exist.
            ShapeError: a value has another size.
            ProblemError: a value is not finite, a weight is negative, bounds exclude each other, or the parameter
                follows from the motion.
        """
        where, known = f"compiled problem ({caller()})", self.parameters
        new = merged(values, named, where)
        checked = {known.key(name, where): known.check(name, value, where) for name, value in new.items()}
        return instance(self, checked, self.initial)

    def with_start(self, initial: ArrayLike) -> CompiledProblem:
        """Return the problem with another initial state (nx,), with the same targets and the same initial guess.

        From another start, the costs lead back to the declared path. In :meth:`Problem.with_initial` the path begins at
        the new initial state instead.

        Raises:
            ShapeError: the initial state has another size.
            ProblemError: it is not finite, or a quaternion is zero.
        """
        return instance(self, {}, initial_state(self.phases[0].mode.model, initial, f"compiled problem ({caller()})"))

    def term_name(self, row: Row) -> str:
        """Return the name of the term that a row belongs to."""
        return "switching" if row.term < 0 else self.terms[row.term].name

    def row_name(self, row: Row) -> str:
        """Return a row's full name: term, component and side."""
        return " ".join(part for part in (self.term_name(row), row.label, row.side) if part)

    if not TYPE_CHECKING:  # mypy still reports the old names as unknown
        __getattr__ = renamed_members(
            "CompiledProblem",
            {"numbers": "parameters", "with_numbers": "with_parameters(values), and with_start(initial) after it"},
        )


def instance(compiled: CompiledProblem, values: Mapping[ParameterKey, Array], initial: Array) -> CompiledProblem:
    """Return a problem with other values of parameters and another initial state, which have been checked.

    Args:
        compiled: the problem.
        values: key → value (size,), from :meth:`Parameters.key` and :meth:`Parameters.check`.
        initial: result of :func:`initial_state`. Targets stay, and the initial guess except for its first state.

    Raises:
        ProblemError: bounds exclude each other.
    """
    phases = [renumbered(phase, compiled.terms, values) if values else phase for phase in compiled.phases]
    if initial is not compiled.initial:
        guess = phases[0].guess_states.copy()
        guess[0] = initial
        phases[0] = replace(phases[0], guess_states=guess)
    return replace(compiled, phases=tuple(phases), initial=initial)
