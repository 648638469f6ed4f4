"""The horizon of a problem at any time: a compiled problem from tables and functions, in constant time and memory."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError

from ..compiler.checks import require_derivatives
from ..compiler.compile import Compilation
from ..compiler.compiled import CompiledProblem
from ..compiler.guess_checks import check_controls
from ..compiler.mode import Row
from ..compiler.transition import LoweredTransition
from ..language import ORIGIN, Problem, model_of, relative
from .calendar import Calendar, Place
from .checks import checked_commands, checked_state, refuse_modes_inside
from .course import Course, Courses
from .falls import Falls
from .phases import Phases, filled
from .samples import Samples
from .spans import SpanLayout
from .tables import LANDS, OWN, Tables

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
        first: the compiled problem of the horizon at the motion's start.

    Raises:
        ProblemError: the problem does not compile, a time step or phase does not fit the grid, or a control has no
            running cost at the motion's start.
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
        samples = Samples(compilation, calendar)
        self.targets = samples.targets
        self.tables = Tables(compilation, calendar, self.targets, samples.at)
        refuse_modes_inside(self.layout, self.tables)
        self.state_copies = tuple(self.targets.state_copies(model) for model in self.models)
        self.falls = Falls(compilation, calendar, samples.at)
        self.acting = tuple(self.targets.acting_copies(model) for model in self.models)
        pieces = [samples.piece(number) for number in range(len(problem.motion.pieces))]
        self.courses = Courses(self.models[0], calendar, self.targets, pieces, samples.packed, samples.placed)
        self._phases = Phases(compilation, self.layout, self.tables, self.courses, self.state_copies, self.acting)
        self.first = self.at(self.begin(problem.initial, 0.0), problem.initial)
        compilation.check_bound(self.first.phases, complete=False)
        check_controls(self.first)

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
        return self.first.row_name(row)

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
        return checked_state(self.models[0], x)

    def checked_commands(self, commands: Mapping[str, float]) -> dict[str, float]:
        """Return commands as numbers; raise for an unknown name or a value that is not finite."""
        return checked_commands(self.commands, commands)

    # ---- numbers

    def at(self, course: Course, x: ArrayLike) -> CompiledProblem:
        """Return the compiled problem of a horizon that begins at the present of a course.

        Args:
            course: the motion as seen from the present.
            x: initial state in the plan's frame (nx,).
        """
        spans = self.layout.at(course.tick)
        phases = tuple(self._phases.at(i, spans, course) for i in range(len(spans)))
        phases[0].guess_states[0] = x
        compilation = self._compilation
        return CompiledProblem(
            phases=phases, initial=np.array(x, dtype=float), terms=compilation.terms, scopes=compilation.scopes,
            path=compilation.path, unbound=compilation.unbound, changing=frozenset(compilation.numbers.changing),
            lowered=0, compile_s=0.0,
        )  # fmt: skip

    def landing_state(self, course: Course, place: Place) -> Array:
        """Return the state of the targets at the end of a phase, (nx,), in the frame of a course."""
        sample = self.courses.samples(course, [(place, place.start + self.calendar.entries[place.entry].length)])[0]
        own, space = self.state_copies[0], self.models[0].state
        x = np.zeros(space.nx)
        x[list(own.to)] = sample[list(own.of)]
        return space.np_normalise(x)

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
        return store.lowered, filled(store, link[1:3], sample)
