"""The course of a motion in the frame of a planner: where its references are placed, seen from the present."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from ..language import ORIGIN, ModelBase, PlanarFrame, ReferenceFunctions, composed, relative, transform_state
from .calendar import Calendar, Place
from .targets import TargetVector

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PieceTable:
    """What the course needs of one piece of a motion.

    Args:
        functions: its reference as functions of time; None if its samples are tabulated.
        places: per entry of the sample vector, the entry of the function's sample; -1 where it has none.
        schedules: per entry of the calendar, the numbers of the phase, (entries of the piece, num_schedule).
        start: what ``begin`` needs at the piece's start on the declared path; empty for a table.
        first, last: planar frames of the declared path at the piece's start and end.
        turn: planar motion of the declared path in one cycle, for the tables of an endless piece.
    """

    functions: ReferenceFunctions | None
    places: tuple[int, ...]
    schedules: Array
    start: Array
    first: PlanarFrame
    last: PlanarFrame
    turn: PlanarFrame

    def commanded(self, commands: Mapping[str, float]) -> Array:
        """Return the command of the functions: commanded values by name, else the declared ones."""
        assert self.functions is not None  # a table has no command
        declared = zip(self.functions.commands, self.functions.command, strict=True)
        return np.array([commands.get(name, value) for name, value in declared], dtype=float)


@dataclass(frozen=True, eq=False)
class Course:
    """A motion as seen from the present, in the plan's frame.

    Args:
        tick: the present.
        place: the phase at the present.
        anchor: the plan's frame in the world, (x, y, yaw) [m, m, rad].
        moved: planar motion from the frame of the plan before to this one.
        frame: planar motion from the declared path to the plan's frame, for tables, in the present cycle.
        memory: memory of the functions of the present piece; empty for a table.
        commands: commanded values that differ from the declared ones, by name.
    """

    tick: int
    place: Place
    anchor: PlanarFrame
    moved: PlanarFrame
    frame: PlanarFrame
    memory: Array
    commands: Mapping[str, float]

    def commanded(self, commands: Mapping[str, float]) -> Course:
        """Return the course with other commands; they begin at the next tick."""
        return replace(self, commands={**self.commands, **commands})


@dataclass(frozen=True, eq=False)
class _Ahead:
    """A piece of the horizon: its frame or memory, and the tick that its memory calls now."""

    frame: PlanarFrame
    memory: Array
    now: int


class Courses:
    """Makes courses, and their samples.

    Args:
        model: the first model, whose states are measured.
        calendar: the phases.
        targets: the sample vector.
        pieces: the pieces.
        tables: samples at the ticks of every entry, (length + 1, size) each.
        placed: see ``AddedTargets.placed``; for samples of tables.
    """

    def __init__(
        self,
        model: ModelBase,
        calendar: Calendar,
        targets: TargetVector,
        pieces: Sequence[PieceTable],
        tables: Sequence[Array],
        placed: cs.Function | None = None,
    ) -> None:
        self.model, self.calendar, self.targets = model, calendar, targets
        self.pieces, self.tables, self.placed = pieces, tables, placed

    def begin(self, x: Array, k: int, commands: Mapping[str, float]) -> Course:
        """Return the course of a motion in which a piece becomes the present one at tick k.

        Args:
            x: measured state in the world (nx,).
            k: the tick.
            commands: commanded values.
        """
        calendar = self.calendar
        place = calendar.at(k)
        number = calendar.entries[place.entry].placed.piece
        functions, pose = self.pieces[number].functions, self.pose(x)
        if functions is None:
            sample = self.targets.unpack(self.tables[place.entry][k - place.start])
            planned = self.model.planar_frame(sample)
            anchor, memory = relative(pose, planned), np.zeros(0)
        else:
            anchor = pose
            start = functions.start(self.moved(x, relative(ORIGIN, anchor)))
            memory = functions.placed(functions.begin, start, self.pieces[number].commanded(commands), anchor=anchor)
        return Course(k, place, anchor, ORIGIN, ORIGIN, memory, dict(commands))

    def advance(self, course: Course, x: Array, k: int) -> Course:
        """Return the course at a later tick, from the state measured then."""
        calendar = self.calendar
        place = calendar.at(k)
        entry = calendar.entries[place.entry]
        if entry.placed.piece != calendar.entries[course.place.entry].placed.piece:
            new = self.begin(x, k, course.commands)
            moved = composed(relative(ORIGIN, new.anchor), course.anchor)
            return Course(k, place, new.anchor, moved, new.frame, new.memory, course.commands)
        piece = self.pieces[entry.placed.piece]
        if piece.functions is None:
            frame = course.frame
            for _ in range(self._cycle(place) - self._cycle(course.place)):
                frame = composed(frame, piece.turn)
            return Course(k, place, course.anchor, ORIGIN, frame, course.memory, course.commands)
        functions, pose = piece.functions, self.pose(x)
        moved = composed(relative(ORIGIN, pose), course.anchor)
        memory = functions.move(course.memory, np.array(moved))
        memory = functions.placed(
            functions.advance, memory, (k - course.tick) * calendar.tick, self.moved(x, relative(ORIGIN, pose)),
            piece.commanded(course.commands), (place.start - k) * calendar.tick, self._schedule(place), anchor=pose,
        )  # fmt: skip
        return Course(k, place, pose, moved, ORIGIN, memory, course.commands)

    def samples(self, course: Course, nodes: Sequence[tuple[Place, int]]) -> Array:
        """Return the samples at nodes, (n, size): pairs of the phase that decides where targets jump, and the tick."""
        ahead = [_Ahead(course.frame, course.memory, course.tick)]
        present = self.calendar.entries[course.place.entry].placed.piece
        found = np.zeros((len(nodes), self.targets.size))
        for row, (place, k) in zip(found, nodes, strict=True):
            number = self.calendar.entries[place.entry].placed.piece
            while present + len(ahead) <= number:
                ahead.append(self._following(present + len(ahead) - 1, ahead[-1], course))
            row[:] = self._sample(number, ahead[number - present], course, place, k)
        return found

    def pose(self, x: Array) -> PlanarFrame:
        """Return the planar frame of a state (nx,)."""
        return self.model.planar_frame(self.model.state.unpack(x))

    def moved(self, x: Array, motion: PlanarFrame) -> Array:
        """Return states of the first model (..., nx) moved by a planar motion."""
        return transform_state(self.model.state, x, motion)

    # ---- one piece

    def _sample(self, number: int, at: _Ahead, course: Course, place: Place, k: int) -> Array:
        piece, targets = self.pieces[number], self.targets
        if piece.functions is None:
            frame = at.frame
            for _ in range(self._cycle(place) - (self._cycle(course.place) if at.now == course.tick else 0)):
                frame = composed(frame, piece.turn)
            moved = targets.moved(self.tables[place.entry][k - place.start], frame)
            return moved if self.placed is None else _column(self.placed(moved, np.array(course.anchor)))
        values = np.append(self._of_functions(piece.functions, at, place, k, course.anchor), 0.0)
        places = np.array(piece.places, dtype=int)
        initial = np.concatenate([np.zeros(0), *(np.ravel(v) for v in targets.initial)])
        return np.where(places >= 0, values[places], initial)

    def _of_functions(
        self, functions: ReferenceFunctions, at: _Ahead, place: Place, k: int, anchor: PlanarFrame
    ) -> Array:  # fmt: skip
        """Return the sample of functions at a tick, (num_sample,)."""
        tick = self.calendar.tick
        return functions.placed(
            functions.sample, (k - at.now) * tick, at.memory, (place.start - at.now) * tick, self._schedule(place),
            anchor=anchor,
        )  # fmt: skip

    def _following(self, number: int, at: _Ahead, course: Course) -> _Ahead:
        """Return the next piece of the horizon, placed at the end of a piece."""
        calendar, piece, after = self.calendar, self.pieces[number], self.pieces[number + 1]
        first, start = calendar.firsts[number + 1]
        if piece.functions is None:
            end = composed(at.frame, piece.last)
        else:
            pose = _column(piece.functions.pose((start - at.now) * calendar.tick, at.memory))
            end = (float(pose[0]), float(pose[1]), float(pose[2]))
        frame = relative(end, after.first)
        if after.functions is None:
            return _Ahead(frame, np.zeros(0), start)
        command, functions = after.commanded(course.commands), after.functions
        if piece.functions is None:  # begun on the declared path, which the frame moves
            there = composed(course.anchor, frame)
            memory = functions.move(
                functions.placed(functions.begin, after.start, command, anchor=there), np.array(frame)
            )  # fmt: skip
        else:
            place = Place(first - 1, first - 1, start - calendar.entries[first - 1].length)
            s = self._of_functions(piece.functions, at, place, start, course.anchor)
            picked = functions.pick(piece.functions.quantities)(s)
            memory = functions.placed(functions.begin, picked, command, anchor=course.anchor)
        return _Ahead(ORIGIN, _column(memory), start)

    def _schedule(self, place: Place) -> Array:
        piece = self.calendar.entries[place.entry].placed.piece
        return np.asarray(self.pieces[piece].schedules[place.entry - self.calendar.firsts[piece][0]])

    def _cycle(self, place: Place) -> int:
        return self.calendar.cycles(place)


def _column(values: object) -> Array:
    return np.asarray(values, dtype=float).ravel()
