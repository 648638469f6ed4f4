"""The horizon of a problem at any time: a compiled problem from tables and functions, in constant time and memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError, ShapeError, UnknownNameError

from ..compiler.checks import require_derivatives
from ..compiler.compile import Compilation
from ..compiler.compiled import CompiledProblem
from ..compiler.compiled_phase import CompiledPhase
from ..compiler.mode import LoweredMode, Row
from ..compiler.transition import LoweredTransition
from ..language import (
    ORIGIN,
    SCHEDULED,
    PlacedPhase,
    Problem,
    model_of,
    relative,
)
from .calendar import Calendar, Place
from .course import Course, Courses
from .falls import Falls
from .samples import Samples
from .spans import Span, SpanLayout
from .tables import LANDS, OWN, RESETS, Indices, RowStore, Tables
from .targets import Copies

Array = NDArray[np.float64]


class Horizon:
    """A problem whose horizon may begin at any time of its motion.

    The motion is placed once. What does not change with time is in tables, one row for equal nodes; targets come from
    tables or, for a gait, from functions of time and command. ``at`` then takes constant time and memory, also after an
    hour. Its result equals that of ``compile_problem`` for a motion that is placed at the measured state.

    Planning happens in a frame (x, y, yaw) of its own: that of the measured base for a reference with functions, at
    every tick; for other pieces the frame in which their path begins at the measured base, set once.

    Args:
        problem: the declaration.

    Attributes:
        problem, models: the declaration, and the models of its schedule.
        calendar: the phases on a grid of ticks. layout: the parts of a horizon. tables: numbers of the nodes.
        targets: the quantities of a sample. courses: references in the plan's frame. falls: flights and landings.

    Raises:
        ProblemError: the problem does not compile, or a time step or phase does not fit the grid.
    """

    latest = 1e7
    """Time [s] from which on no horizon begins: rounding errors of times come near to ``SAME_TIME``."""

    def __init__(self, problem: Problem) -> None:
        require_derivatives(problem, "Horizon")
        self.problem = problem
        self._compilation = compilation = Compilation(problem)
        self.models = tuple(model_of(segment) for segment in problem.schedule.segments)
        self.calendar = calendar = Calendar(problem.motion.pieces, problem.schedule)
        self.layout = SpanLayout(calendar, problem.schedule)
        self._refuse_ends_inside()
        samples = Samples(compilation, calendar)
        self.targets = samples.targets
        self.tables = Tables(compilation, calendar, self.targets, samples.at)
        self._refuse_modes_inside()
        self.state_copies = tuple(self.targets.state_copies(model) for model in self.models)
        self.falls = Falls(compilation, calendar, samples.at)
        self.acting = tuple(self.targets.acting_copies(model) for model in self.models)
        pieces = [samples.piece(number) for number in range(len(problem.motion.pieces))]
        self.courses = Courses(self.models[0], calendar, self.targets, pieces, samples.packed)
        self._first = self.at(self.begin(problem.initial, 0.0), problem.initial)
        compilation.check_bound(self._first.phases, complete=False)

    @property
    def dt(self) -> float:
        """Time step of the first model [s]; plans begin at its multiples."""
        return self.problem.schedule.segments[0].dt

    @property
    def duration(self) -> float:
        """Length of the motion [s]; infinite if it is cyclic."""
        return self.calendar.total * self.calendar.tick

    @property
    def commands(self) -> dict[str, float]:
        """The declared values of all commands, by name; a later piece's value if several have one."""
        found: dict[str, float] = {}
        for piece in self.courses.pieces:
            if piece.functions is not None:
                found |= dict(zip(piece.functions.commands, map(float, piece.functions.command), strict=True))
        return found

    def row_name(self, row: Row) -> str:
        """Return the name of a row: term, component and side."""
        return self._first.row_name(row)

    # ---- courses

    def begin(self, x: ArrayLike, t: float, commands: Mapping[str, float] | None = None) -> Course:
        """Return the motion as seen from a measured state (nx,) at time t [s], the first of a controller.

        Args:
            x: the state, in the world.
            t: time since the motion's start [s], rounded to a multiple of ``dt``.
            commands: commanded values that differ from the declared ones, by name.

        Raises:
            ProblemError: the time is outside the motion, or the state is not finite.
            ShapeError: the state has another size.
            UnknownNameError: there is no such command.
        """
        return self.courses.begin(self.checked(x), self.tick_of(t), self.checked_commands(commands or {}))

    def advance(self, course: Course, x: ArrayLike, t: float, commands: Mapping[str, float] | None = None) -> Course:
        """Return the motion as seen from a state measured later, see :meth:`begin`; commands stay if not given.

        Raises:
            ProblemError: the time is before that of the course.
        """
        k = self.tick_of(t)
        if k < course.tick:
            raise ProblemError(
                f"horizon: time goes back - got {t:g} s after {course.tick * self.calendar.tick:g} s, expected a later "
                "one; begin again"
            )
        if commands is not None:
            course = course.commanded(self.checked_commands(commands))
        return self.courses.advance(course, self.checked(x), k)

    def local(self, course: Course, x: ArrayLike) -> Array:
        """Return a state in the world (nx,) in the frame of a course."""
        return self.courses.moved(np.asarray(x, dtype=float), relative(ORIGIN, course.anchor))

    def tick_of(self, t: float) -> int:
        """Return the tick of a time since the motion's start [s], a multiple of the first model's step."""
        step = self.calendar.steps[0]
        k = round(t / self.dt) * step if abs(t) < self.latest else -1  # not NaN either
        if not 0 <= k <= self.calendar.total - step:
            raise self.outside(t)
        return k

    def outside(self, t: float) -> ProblemError:
        """Return the error of a time at which no plan can begin."""
        return ProblemError(
            f"horizon: time is outside the motion - got t = {t:g} s, expected 0 ≤ t ≤ "
            f"{min(self.duration - self.dt, self.latest):g} s; "
            "stop the controller there, or declare a longer motion"
        )

    def checked(self, x: ArrayLike) -> Array:
        """Return a measured state (nx,); raise if it has another size or is not finite."""
        state = np.asarray(x, dtype=float)
        space = self.models[0].state
        if state.shape != (space.nx,):
            raise ShapeError(
                f"horizon, model '{self.models[0].name}': state has the wrong size - got shape {state.shape}, expected "
                f"({space.nx},); give the state of this model"
            )
        if not np.all(np.isfinite(state)):
            bad = space.stored_labels[int(np.flatnonzero(~np.isfinite(state))[0])]
            raise ProblemError(
                f"horizon: state is not finite - got {state[~np.isfinite(state)][0]} in '{bad}', expected numbers; "
                "check the estimator"
            )
        return state

    def checked_commands(self, commands: Mapping[str, float]) -> dict[str, float]:
        """Return commands as numbers; raise for an unknown name or a value that is not finite."""
        for name, value in commands.items():
            if name not in self.commands:
                raise UnknownNameError("horizon", "command", name, self.commands)
            if not (isinstance(value, int | float | np.number) and np.isfinite(value)):
                raise ProblemError(
                    f"horizon, command '{name}': is not finite - got {value!r}, expected a number; fix it"
                )
        return {name: float(value) for name, value in commands.items()}

    # ---- numbers

    def at(self, course: Course, x: ArrayLike) -> CompiledProblem:
        """Return the compiled problem of a horizon that begins at the present of a course.

        Args:
            course: the motion as seen from the present.
            x: initial state in the plan's frame (nx,).
        """
        spans = self.layout.at(course.tick)
        phases = tuple(self._phase(i, spans, course) for i in range(len(spans)))
        phases[0].guess_states[0] = x
        compilation = self._compilation
        return CompiledProblem(
            phases=phases, initial=np.array(x, dtype=float), terms=compilation.terms, scopes=compilation.scopes,
            path=compilation.path, unbound=compilation.unbound, changing=frozenset(compilation.numbers.changing),
            lowered=0, compile_s=0.0,
        )  # fmt: skip

    def arrival(self, course: Course, k: int | None = None) -> tuple[LoweredTransition, Array] | None:
        """Return the impact at the present, or at a later tick k, and its parameters; None if no landing is then.

        A measured state may be from before or after it. The impact changes only a state from before it: the velocities
        of the landing feet are already zero after it. A reset of the user has no such property, so with one the state
        counts as after both.
        """
        calendar, at = self.calendar, course.tick if k is None else k
        place = calendar.at(at)
        before = calendar.previous(place)
        if place.start != at or before < 0 or not self.layout.cut[0]:
            return None
        table = self.tables.segments[0]
        link = table.link[0, int(table.first[before]) + calendar.entries[before].length]
        if link[0] < 0 or not link[3] & LANDS or link[3] & OWN:
            return None
        store = self.tables.transitions[int(link[0])]
        assert isinstance(store.lowered, LoweredTransition)
        sample = self.courses.samples(course, [(place, at)])[0]
        return store.lowered, _filled(store, link[1:3], sample)

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
            while not self.layout.cut[span.segment]:
                end = place.start + calendar.entries[place.entry].length
                if k < end or (j == span.stages and k == end):
                    break
                place = calendar.next(place)
            found.append((place, k))
        return found

    def _phase(self, i: int, spans: Sequence[Span], course: Course) -> CompiledPhase:
        span, calendar, tables = spans[i], self.calendar, self.tables
        table, segment = tables.segments[span.segment], self.problem.schedule.segments[span.segment]
        mode_number = int(table.mode[span.place.entry])
        store = tables.modes[mode_number]
        nodes, middles = self.nodes(span), self.middles(span)
        samples = self.courses.samples(course, nodes)
        if middles != nodes[:-1]:
            acting = self.acting[span.segment]
            samples[:-1, list(acting.to)] = self.courses.samples(course, middles)[:, list(acting.of)]
        at = [int(table.first[place.entry]) + k - place.start for place, k in (*middles, nodes[-1])]
        p = np.array([
            _filled(store, table.stage[row], sample) for row, sample in zip(at[:-1], samples, strict=False)
        ])  # fmt: skip
        p_end = _filled(store, table.end[int(span.last), at[-1]], samples[-1])
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
            p_transition = _filled(links, link[1:3], samples[-1])
            rows = self._compilation.reset_weights(transition)(p_transition[None])
            at_end = [np.concatenate(both, axis=1) for both in zip(ends, rows, strict=True)]
        model = self.models[span.segment]
        own = self.state_copies[span.segment]
        states = np.zeros((len(samples), model.state.nx))
        states[:, list(own.to)] = samples[:, list(own.of)]
        placed = self.placed(span.place)
        cut = self.layout.cut[span.segment]
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

    def placed(self, place: Place) -> PlacedPhase:
        """Return the motion phase at a place, with its own times and index."""
        calendar = self.calendar
        own = calendar.entries[place.entry]
        start = place.start * calendar.tick
        return PlacedPhase(
            own.phase, own.placed.piece, calendar.index(place), start, start + own.length * calendar.tick
        )  # fmt: skip

    def _refuse_ends_inside(self) -> None:
        """Raise if a phase with a reset or ``until`` may end inside a part of the horizon."""
        for model, cut in zip(self.models, self.layout.cut, strict=True):
            for entry in () if cut else self.calendar.entries:
                phase = entry.phase
                if phase.reset is not None or phase.until:
                    what = "reset" if phase.reset is not None else "until"
                    raise ProblemError(
                        f"phase '{phase.name}' ({phase.source}): its end comes to be inside a phase of model "
                        f"'{model.name}' - got a {what}, expected none where '{model.name}' plans; remove it, or "
                        "schedule only models with a phase per mode"
                    )

    def _refuse_modes_inside(self) -> None:
        """Raise if a part of the horizon may contain modes with other dynamics than that at its start."""
        for model, cut, table in zip(self.models, self.layout.cut, self.tables.segments, strict=True):
            if not cut and len(keys := dict.fromkeys(self.tables.modes[i].lowered.key for i in table.mode)) > 1:
                raise ProblemError(
                    f"horizon, model '{model.name}': has one phase for all modes and several dynamics - got "
                    f"{', '.join(keys)}, expected one; return one key from mode_key, or set cut_by_modes"
                )


def _filled(store: RowStore, which: Indices, sample: Array) -> Array:
    """Return a parameter row with what it takes from a sample; ``which`` is the row and its copies."""
    p: Array = store.rows[int(which[0])].copy()
    own: Copies = store.copies[int(which[1])]
    p[list(own.to)] = sample[list(own.of)]
    return p
