"""Problem: motion, schedule, objective, constraints and initial state, as one value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError
from piaffe.html import html_table

from .initial import initial_state
from .model import ModelBase, ProblemWarning, model_of
from .motion import Motion
from .parameter_names import check_value, find_key, merged, parameter_names
from .phase import Phase
from .schedule import Schedule
from .source import Source, caller
from .term import Constraint, Cost
from .termset import Constraints, Objective

Array = NDArray[np.float64]


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Problem:
    """One declaration of an optimal-control problem.

    Args:
        motion: phases and targets.
        schedule: models and time steps along the horizon.
        objective: costs to minimise.
        constraints: conditions that must hold.
        initial: initial state of the first model, (nx,).
        parameters: values that replace declared ones, by the names that :meth:`with_parameters` lists.
    """

    motion: Motion
    schedule: Schedule
    objective: Objective
    constraints: Constraints
    initial: Array
    parameters: Mapping[str, Array] = field(default_factory=dict)
    source: Source = field(default_factory=caller)

    def __init__(
        self,
        motion: Motion,
        schedule: Schedule,
        objective: Objective,
        constraints: Constraints | None = None,
        *,
        initial: ArrayLike,
        parameters: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        source = caller()
        kinds: tuple[tuple[str, object, type], ...] = (
            ("motion", motion, Motion),
            ("schedule", schedule, Schedule),
            ("objective", objective, Objective),
            ("constraints", constraints or Constraints(), Constraints),
        )
        for name, value, kind in kinds:
            if not isinstance(value, kind):
                raise ProblemError(
                    f"problem ({source}): {name} is unusable - got {type(value).__name__}, expected "
                    f"ocp.{kind.__name__}; make one"
                )
        for key, entry in {
            "motion": motion,
            "schedule": schedule,
            "objective": objective,
            "constraints": constraints or Constraints(),
            "source": source,
            "parameters": {},
        }.items():
            object.__setattr__(self, key, entry)
        object.__setattr__(self, "initial", self._checked_initial(initial, schedule))
        object.__setattr__(self, "parameters", self._checked_parameters(merged(parameters, {}, self.where), schedule))

    @property
    def where(self) -> str:
        """The declaration with its file and line, for messages."""
        return f"problem ({self.source})"

    def with_parameters(self, values: Mapping[str, ArrayLike] | None = None, /, **named: ArrayLike) -> Problem:
        """Return the problem with other values of parameters; no function is compiled again.

        A parameter has the same name and the same values here and in :meth:`CompiledProblem.with_parameters`; the
        compiled problem lists all of them in ``parameters``.

        =====================  ==========================================================================
        name                   parameter
        =====================  ==========================================================================
        ``"NAME"``             an ``ocp.parameter``
        ``"MODEL.SLOT"``       a model's: ``"mini_cheetah.link_mass"``, ``"mini_cheetah.terrain"``
        ``"TERM.PARAMETER"``   a term's own: ``"friction cone.mu"``
        ``"TERM.weight"``      a cost's weights, in the phases where it applies
        ``"TERM.target"``      a cost's own target (``to=``), if it is no rotation
        ``"TERM.lower"``       a constraint's bounds, if it has that side; ``"TERM.upper"`` likewise
        =====================  ==========================================================================

        Terms that share a name get an index in their order: ``"TERM[0].weight"``. If a weight differs by phase, the new
        value replaces it in every phase where it is not zero.

        Args:
            values: name → value, with as many entries as now; an infinite bound is no bound.
            named: the same as keywords, for names that are Python identifiers.

        Raises:
            UnknownNameError: there is no such parameter; the message lists those that exist. Only the compiler finds
                each ``ocp.parameter``, so the compilation reports an unknown name without a dot, and a wrong size.
            ShapeError: a value has another size.
            ProblemError: a value is not finite, or a weight is negative.
        """
        where = f"problem ({caller()})"  # the line of this call, where the numbers are
        checked = self._checked_parameters(merged(values, named, where), self.schedule, where)
        return self._with("parameters", {**self.parameters, **checked})

    def with_initial(self, initial: ArrayLike) -> Problem:
        """Return the problem with another initial state, (nx,); the path of targets begins there."""
        model = model_of(self.schedule.segments[0])
        return self._with("initial", initial_state(model, initial, f"problem ({caller()})"))

    def with_schedule(self, schedule: Schedule) -> Problem:
        """Return the problem with another schedule; its first model must have the same state."""
        self._checked_initial(self.initial, schedule)
        self._checked_parameters(self.parameters, schedule)
        return self._with("schedule", schedule)

    def scoped_terms(self) -> list[tuple[Cost | Constraint, Phase | None]]:
        """Return every term, in the order of a compiled problem, with the phase that declares it, or None."""
        terms: list[tuple[Cost | Constraint, Phase | None]] = [(t, None) for t in (*self.objective, *self.constraints)]
        for phase in dict.fromkeys(phase for piece in self.motion.pieces for phase in piece.phases):
            terms += [(term, phase) for term in (*phase.objective, *phase.constraints, *phase.until)]
        return terms

    def _checked_initial(self, initial: ArrayLike, schedule: Schedule) -> Array:
        return initial_state(model_of(schedule.segments[0]), initial, self.where)

    def _checked_parameters(
        self, values: Mapping[str, ArrayLike], schedule: Schedule, where: str = ""
    ) -> dict[str, Array]:
        if not values:
            return {}
        models: list[ModelBase] = [model_of(segment) for segment in schedule.segments]
        names = parameter_names([term for term, _ in self.scoped_terms()], models)
        return {
            name: check_value(name, find_key(names, name, where or self.where), value, where or self.where)
            for name, value in values.items()
        }

    def _with(self, name: str, value: object) -> Problem:
        other = object.__new__(Problem)
        other.__dict__.update(self.__dict__)
        other.__dict__[name] = value
        return other

    def warnings(self) -> list[ProblemWarning]:
        """Return what is likely a mistake in the problem; a solver issues the same warnings before it iterates.

        Raises:
            ProblemError: the declaration is inconsistent.
        """
        from ..compiler import compile_problem
        from ..reports import early_warnings, find_warnings

        return early_warnings(self) + find_warnings(compile_problem(self))

    def __repr__(self) -> str:
        parts = ", ".join(
            f"{segment.model.name} {'until the end' if segment.duration is None else f'{segment.duration:g} s'}"
            f" in {segment.dt:g} s"
            for segment in self.schedule.segments
        )
        terms = f"{len(tuple(self.objective))} costs, {len(tuple(self.constraints))} constraints"
        return f"Problem({self.source}: {self.motion!r}; {parts}; {terms})"

    def _repr_html_(self) -> str:
        terms = [
            (
                "cost" if isinstance(term, Cost) else term.kind,
                term.name,
                term.at,
                "all" if phase is None else phase.name,
            )
            for term, phase in self.scoped_terms()
        ]
        return self.motion._repr_html_() + html_table(repr(self), ("kind", "term", "at", "phases"), terms)

    def __str__(self) -> str:
        from ..compiler import compile_problem
        from ..reports import describe

        return describe(compile_problem(self))
