"""The compiled problem: flat phases of numbers and functions, the seam between language and solvers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..language import Constraint, Cost, Path, Phase, PlacedPhase
from .mode import LoweredMode, Row
from .transition import LoweredTransition

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CompiledPhase:
    """A stretch of the horizon with one mode and one time step.

    Args:
        name: the motion phase's name.
        label: the mode as text.
        interval: the motion phase (the first one, if a model spans several).
        mode: functions.
        dt: time step [s].
        times: node times (N+1,) [s].
        p: parameters of the stages (N, np).
        p_end: parameters of the last node (np,).
        weight: residual weights of the stages (N, nr), masks folded in.
        g_mask: 0 or 1 per stage and inequality row (N, ng).
        h_mask: the same for equalities (N, nh).
        end_weight, end_g_mask, end_h_mask: the same for the last node's rows.
        ends_phase: whether the motion's phase ends at the last node.
        transition: to the next phase; None at the end of the horizon.
        p_transition: its parameters.
        resets: whether the transition does more than copy the state (an impact, a user's reset, another model).
        guess_states: initial guess (N+1, nx).
        guess_controls: initial guess (N, nu).
    """

    name: str
    label: str
    interval: PlacedPhase
    mode: LoweredMode
    dt: float
    times: Array
    p: Array
    p_end: Array
    weight: Array
    g_mask: Array
    h_mask: Array
    end_weight: Array
    end_g_mask: Array
    end_h_mask: Array
    ends_phase: bool
    transition: LoweredTransition | None
    p_transition: Array
    resets: bool
    guess_states: Array
    guess_controls: Array

    @property
    def num_stages(self) -> int:
        """N."""
        return len(self.p)


@dataclass(frozen=True, eq=False)
class CompiledProblem:
    """Flat phases, the initial state and the terms that their rows come from.

    Args:
        phases: in the order of time.
        initial: initial state (nx,).
        terms: costs and constraints; rows refer to them by index.
        scopes: per term the motion phase that declares it, None for terms of the whole problem.
        path: the targets over time.
        unbound: per (model name, term index) why a term is not in that model.
        changing: numbers of models, ``"model.slot"``, that follow from the motion, node by node.
        lowered: how many modes and transitions had to be built for this problem (0: everything was known).
        compile_s: time spent compiling [s].
    """

    phases: tuple[CompiledPhase, ...]
    initial: Array
    terms: tuple[Cost | Constraint, ...]
    scopes: tuple[Phase | None, ...]
    path: Path
    unbound: Mapping[tuple[str, int], str]
    changing: frozenset[str]
    lowered: int
    compile_s: float

    @property
    def num_stages(self) -> int:
        """Stages of the whole horizon."""
        return sum(phase.num_stages for phase in self.phases)

    @property
    def numbers(self) -> Mapping[str, Array]:
        """Every number that may vary from instance to instance, by name, with its present value (size,).

        Names are those of ``ocp.parameter``, ``"MODEL.SLOT"`` for a model's numbers, ``"TERM.PARAMETER"`` for a term's,
        ``"TERM.weight"``, ``"TERM.target"``, ``"TERM.lower"`` and ``"TERM.upper"``; terms that share a name are told
        apart by their order, ``"TERM[0].weight"``. What follows from the motion node by node (contacts, footholds,
        targets along the path) is not among them.
        """
        from .named_numbers import named_numbers

        return {name: number.value for name, number in named_numbers(self).items()}

    def with_numbers(self, values: Mapping[str, ArrayLike], initial: ArrayLike | None = None) -> CompiledProblem:
        """Return the problem with other values of some of its ``numbers``; nothing is compiled.

        Args:
            values: name → value, as many entries as it has now; a bound may be infinite for none.
            initial: another initial state (nx,). Targets and guess stay those of the declared one, so that a start
                beside it is drawn back to the same path.

        Raises:
            UnknownNameError: there is no such number; the message lists them.
            ShapeError: a value or the initial state has another size.
            ProblemError: one is not finite, a weight is negative, or bounds exclude each other.
        """
        from .named_numbers import with_numbers

        return with_numbers(self, values, initial)

    def term_name(self, row: Row) -> str:
        """Return the name of the term that a row belongs to."""
        return "switching" if row.term < 0 else self.terms[row.term].name

    def row_name(self, row: Row) -> str:
        """Return a row's full name: term, component and side."""
        return " ".join(part for part in (self.term_name(row), row.label, row.side) if part)
