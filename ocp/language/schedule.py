"""Schedules: which model, with which time step, covers which part of the horizon."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

from piaffe.errors import ProblemError

from .source import Source, caller
from .time import SAME_TIME, is_same_time
from .user_input import is_number

if TYPE_CHECKING:
    from .term import Constraint, Cost


class ScheduledModel(Protocol):
    """The part of a model that a schedule uses; :class:`ocp.ModelBase` is what the compiler uses."""

    @property
    def name(self) -> str:
        """Its name, for messages."""
        ...

    @property
    def own_step(self) -> float | None:
        """The only time step that it supports [s]; None if it supports any."""
        ...


@dataclass(frozen=True)
class Segment:
    """A part of the horizon with one model.

    Args:
        model: the model.
        duration: length [s]; None: until the motion ends.
        dt: time step [s].
        excluded: terms that are left out here.
        source: where it was declared.
    """

    model: ScheduledModel
    duration: float | None
    dt: float
    excluded: tuple[Cost | Constraint, ...] = ()
    source: Source = field(default_factory=caller)

    def __post_init__(self) -> None:
        for name, value in (("dt", self.dt), ("duration", self.duration)):
            if value is not None and not (is_number(value) and SAME_TIME < value < float("inf")):
                raise ProblemError(
                    f"schedule ({self.source}), model '{self.model.name}': {name} is out of range - got {value!r}, "
                    f"expected a number of seconds above {SAME_TIME:g}; give one"
                )
        own = self.model.own_step
        if own is not None and not is_same_time(self.dt, own):
            raise ProblemError(
                f"schedule ({self.source}), model '{self.model.name}': dt is not the model's own - got {self.dt:g} s, "
                f"expected {own:g} s; change one of them"
            )


@dataclass(frozen=True)
class Schedule:
    """Segments in the order of time: ``body.over(0.25, dt=0.01) + srb.over(0.5, dt=0.05).without(limits)``."""

    segments: tuple[Segment, ...]

    def __add__(self, other: Schedule) -> Schedule:
        if not isinstance(other, Schedule):
            raise ProblemError(
                f"schedule ({caller()}): can be followed by a schedule only - got {type(other).__name__}, expected the "
                "schedule of a model; write model.over(duration, dt) or model.until_end(dt)"
            )
        if self.segments and self.segments[-1].duration is None:
            last = self.segments[-1]
            raise ProblemError(
                f"schedule ({last.source}): nothing can follow a segment that runs until the end - got "
                f"'{other.segments[0].model.name}' after '{last.model.name}'.until_end; use .over(duration, dt) first"
            )
        return Schedule(self.segments + other.segments)

    def without(self, *terms: Cost | Constraint | Iterable[Cost | Constraint]) -> Schedule:
        """Return the schedule with terms (or whole objectives, constraint sets) left out of all its segments."""
        out: list[Cost | Constraint] = []
        for given in terms:
            out.extend(given if isinstance(given, Iterable) and not isinstance(given, str) else (given,))
        for term in out:
            if not hasattr(term, "structure"):  # every term has it
                raise ProblemError(
                    f"schedule ({caller()}): without takes terms - got {term!r}, expected costs, constraints or sets "
                    "of them; pass the objects"
                )
        return Schedule(tuple(replace(s, excluded=s.excluded + tuple(out)) for s in self.segments))
