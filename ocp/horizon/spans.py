"""Spans: the parts of a horizon that begins at a tick, one per model and phase."""

from __future__ import annotations

from dataclasses import dataclass

from piaffe.errors import ProblemError

from ..language import Schedule, is_same_time, model_of
from .calendar import Calendar, Place


@dataclass(frozen=True)
class Span:
    """A part of the horizon with one model and time step.

    Args:
        segment: index of the schedule's segment.
        place: the motion phase at its start.
        first: its first tick.
        stages: number of stages N.
        ends: whether its last node is the end of a motion phase.
        last: whether it is the last of the horizon.
    """

    segment: int
    place: Place
    first: int
    stages: int
    ends: bool
    last: bool


class SpanLayout:
    """The spans of a schedule's horizon at any tick.

    At the end of a finite motion, the horizon becomes shorter: its last node is the last one that is not beyond it.

    Args:
        calendar: the motion.
        schedule: models and time steps.

    Raises:
        ProblemError: a part is not a whole number of steps; a model with a phase per mode has a time step that does not
            divide the phases and the steps of the models before it; a reset or ``until`` may be inside a part.
    """

    def __init__(self, calendar: Calendar, schedule: Schedule) -> None:
        self.calendar, self.schedule = calendar, schedule
        self.cut = tuple(model_of(segment).cut_by_modes for segment in schedule.segments)
        self.windows = tuple(
            None if segment.duration is None else round(segment.duration / calendar.tick)
            for segment in schedule.segments
        )
        self._check()
        self._refuse_ends_inside()

    def _check(self) -> None:
        steps, entries = self.calendar.steps, self.calendar.entries
        for s, (segment, cut, step, window) in enumerate(
            zip(self.schedule.segments, self.cut, steps, self.windows, strict=True)
        ):
            where = f"schedule ({segment.source}), model '{model_of(segment).name}'"
            if window is None and self.calendar.total == float("inf"):
                raise ProblemError(
                    f"{where}: the motion never ends - got until_end on a cyclic motion, expected a finite one; use "
                    ".over(duration, dt)"
                )
            exact = segment.duration is None or is_same_time((window or 0) * self.calendar.tick, segment.duration)
            if window is not None and (window < 1 or window % step or not exact):
                raise ProblemError(
                    f"{where}: not a whole number of steps - got {segment.duration:g} s with dt {segment.dt:g} s, "
                    "expected a multiple; change one"
                )
            if not cut:
                continue
            bad = next((entry for entry in entries if entry.length % step), None)
            if bad is not None:
                raise ProblemError(
                    f"phase '{bad.phase.name}' ({bad.phase.source}): not a whole number of steps of model "
                    f"'{model_of(segment).name}' - got {bad.phase.duration:g} s with dt {segment.dt:g} s, expected a "
                    "multiple; change one"
                )
            for before, other in zip(self.schedule.segments[:s], steps, strict=False):
                if other % step:
                    raise ProblemError(
                        f"{where}: its phases move by the steps of the models before it - got dt {segment.dt:g} s "
                        f"after {before.dt:g} s, expected a dt that divides it; shorten it"
                    )

    def _refuse_ends_inside(self) -> None:
        """Raise if a phase with a reset or ``until`` may end inside a part of the horizon."""
        for model, cut in zip(map(model_of, self.schedule.segments), self.cut, strict=True):
            for entry in () if cut else self.calendar.entries:
                phase = entry.phase
                if phase.reset is not None or phase.until:
                    what = "reset" if phase.reset is not None else "until"
                    raise ProblemError(
                        f"phase '{phase.name}' ({phase.source}): its end comes to be inside a phase of model "
                        f"'{model.name}' - got a {what}, expected none where '{model.name}' plans; remove it, or "
                        "schedule only models with a phase per mode"
                    )

    def at(self, k: int) -> tuple[Span, ...]:
        """Return the spans of the horizon that begins at tick k, a multiple of the first model's step."""
        calendar, spans = self.calendar, []
        place, at = calendar.at(k), k
        for s, (cut, step, window) in enumerate(zip(self.cut, calendar.steps, self.windows, strict=True)):
            end = calendar.total if window is None else min(at + window, calendar.total)
            stop = int(at + (end - at) // step * step)
            while at < stop:
                rest = place.start + calendar.entries[place.entry].length - at
                length = min(rest, stop - at) if cut else stop - at
                first, began = at, place
                at += length
                ends = self._skip(place, at)
                place = ends[0]
                spans.append((s, began, first, length // step, ends[1]))
        count = len(spans)
        return tuple(Span(*each, last=i == count - 1) for i, each in enumerate(spans))

    def nodes(self, span: Span) -> list[tuple[Place, int]]:
        """Return place and tick of a span's nodes (N+1); the place of the last is that of the phase before it."""
        return self._places(span, 0, span.stages + 1)

    def middles(self, span: Span) -> list[tuple[Place, int]]:
        """Return place and tick of what acts during a span's stages (N), see ``Stages``."""
        return self._places(span, self.calendar.halves[span.segment], span.stages)

    def _places(self, span: Span, offset: int, count: int) -> list[tuple[Place, int]]:
        """Return place and tick of so many nodes of a span, each so many ticks later."""
        calendar, found, place = self.calendar, [], span.place
        for j in range(count):
            k = span.first + j * calendar.steps[span.segment] + offset
            while not self.cut[span.segment]:
                end = place.start + calendar.entries[place.entry].length
                if k < end or (j == span.stages and k == end):
                    break
                place = calendar.next(place)
            found.append((place, k))
        return found

    def _skip(self, place: Place, k: int) -> tuple[Place, bool]:
        """Return the place of tick k at or after a phase's start, and whether a phase ends there."""
        calendar = self.calendar
        while place.start + calendar.entries[place.entry].length <= k:
            if place.start + calendar.entries[place.entry].length == k:
                over = calendar.following[place.entry] < 0
                return (place if over else calendar.next(place)), True
            place = calendar.next(place)
        return place, False
