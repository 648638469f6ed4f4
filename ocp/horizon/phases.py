"""The phases of a horizon as compiled phases: rows of the tables, and what they take from samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..compiler.compile import Compilation
from ..compiler.compiled_phase import CompiledPhase
from ..compiler.mode import LoweredMode
from ..compiler.transition import LoweredTransition
from ..language import SCHEDULED, PlacedPhase, model_of
from .calendar import Place
from .course import Course, Courses
from .spans import Span, SpanLayout
from .tables import LANDS, RESETS, Indices, RowStore, Tables
from .targets import Copies

Array = NDArray[np.float64]


class Phases:
    """The compiled phases of a horizon.

    Args:
        compilation: the compiler at work on the problem.
        layout: the parts of a horizon. tables: numbers of the nodes. courses: references in the plan's frame.
        states: per segment, what a state takes from a sample.
        acting: per segment, what stages take from a sample at their middle.
    """

    def __init__(
        self,
        compilation: Compilation,
        layout: SpanLayout,
        tables: Tables,
        courses: Courses,
        states: Sequence[Copies],
        acting: Sequence[Copies],
    ) -> None:
        self._compilation, self._layout, self._tables, self._courses = compilation, layout, tables, courses
        self._states, self._acting = states, acting

    def at(self, i: int, spans: Sequence[Span], course: Course) -> CompiledPhase:
        """Return the compiled phase of a part of the horizon.

        Args:
            i: number of the part.
            spans: the parts.
            course: the motion as seen from the present.
        """
        span, calendar, tables = spans[i], self._layout.calendar, self._tables
        table, segment = tables.segments[span.segment], self._layout.schedule.segments[span.segment]
        mode_number = int(table.mode[span.place.entry])
        store = tables.modes[mode_number]
        nodes, middles = self._layout.nodes(span), self._layout.middles(span)
        samples = self._courses.samples(course, nodes)
        if middles != nodes[:-1]:
            acting = self._acting[span.segment]
            samples[:-1, list(acting.to)] = self._courses.samples(course, middles)[:, list(acting.of)]
        at = [int(table.first[place.entry]) + k - place.start for place, k in (*middles, nodes[-1])]
        p = np.array([
            filled(store, table.stage[row], sample) for row, sample in zip(at[:-1], samples, strict=False)
        ])  # fmt: skip
        p_end = filled(store, table.end[int(span.last), at[-1]], samples[-1])
        mode = store.lowered
        assert isinstance(mode, LoweredMode)
        stage_w, terminal_w = self._compilation.weights(mode)
        weights, ends = stage_w(p), terminal_w(p_end[None])
        transition, p_transition, resets, lands = None, np.zeros(0), False, False
        at_end = list(ends)
        if not span.last:
            to_next = int(spans[i + 1].segment != span.segment)
            link = table.link[to_next, at[-1]]
            links = tables.transitions[int(link[0])]
            assert isinstance(links.lowered, LoweredTransition)
            transition, resets, lands = links.lowered, bool(link[3] & RESETS), bool(link[3] & LANDS)
            p_transition = filled(links, link[1:3], samples[-1])
            rows = self._compilation.reset_weights(transition)(p_transition[None])
            at_end = [np.concatenate(both, axis=1) for both in zip(ends, rows, strict=True)]
        model = model_of(segment)
        own = self._states[span.segment]
        states = np.zeros((len(samples), model.state.nx))
        states[:, list(own.to)] = samples[:, list(own.of)]
        placed = self._placed(span.place)
        cut = self._layout.cut[span.segment]
        times: Array = (span.first + calendar.steps[span.segment] * np.arange(span.stages + 1.0)) * calendar.tick
        return CompiledPhase(
            name=placed.phase.name,
            label=str(self._compilation.resolve(model, placed.phase)) if cut else SCHEDULED,
            interval=placed, mode=mode, dt=segment.dt, times=times, p=p, p_end=p_end,
            applies=np.zeros((span.stages + 1, len(self._compilation.terms)), dtype=bool),
            weight=weights[0], g_mask=weights[1], h_mask=weights[2],
            end_weight=at_end[0][0], end_g_mask=at_end[1][0], end_h_mask=at_end[2][0],
            ends_phase=span.ends, transition=transition, p_transition=p_transition, resets=resets, lands=lands,
            guess_states=model.state.np_normalise(states), guess_controls=table.controls[at[:-1]].copy(),
        )  # fmt: skip

    def _placed(self, place: Place) -> PlacedPhase:
        """Return the motion phase at a place, with its own times and index."""
        calendar = self._layout.calendar
        own = calendar.entries[place.entry]
        start = place.start * calendar.tick
        return PlacedPhase(
            own.phase, own.placed.piece, calendar.index(place), start, start + own.length * calendar.tick
        )  # fmt: skip


def filled(store: RowStore, which: Indices, sample: Array) -> Array:
    """Return a parameter row with what it takes from a sample; ``which`` is the row and its copies."""
    p: Array = store.rows[int(which[0])].copy()
    own: Copies = store.copies[int(which[1])]
    p[list(own.to)] = sample[list(own.of)]
    return p
