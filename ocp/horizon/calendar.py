"""The calendar: the phases of a motion on a grid of whole ticks, with finite tables for an endless motion."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from fractions import Fraction
from math import gcd, inf, lcm
from typing import NamedTuple

from piaffe.errors import ProblemError

from ..language import SAME_TIME, Phase, Piece, PlacedPhase, Schedule, model_of

_FINEST = 1_000_000  # a time step is a fraction of seconds with a denominator up to this
_SHORTEST = 1e-4  # shortest tick [s]
_CYCLES = 3
"""Cycles of an endless piece that have tables of their own; later ones repeat the last.

A foot's stances before and after a phase are those of the same cycle, of the two before it, and of the next.
"""


class Place(NamedTuple):
    """Where a tick is in the motion.

    Attributes:
        entry: index of the phase among the entries of the calendar.
        number: number of phases before it since the motion's start; it tells occurrences of an entry apart.
        start: first tick of the phase.
    """

    entry: int
    number: int
    start: int


@dataclass(frozen=True)
class Entry:
    """A phase in the calendar.

    Args:
        placed: its first occurrence: phase, piece, index in the piece, start and end [s].
        start: first tick of that occurrence.
        length: number of ticks.
    """

    placed: PlacedPhase
    start: int
    length: int

    @property
    def phase(self) -> Phase:
        """The phase."""
        return self.placed.phase


class Calendar:
    """The phases of a motion on the ticks of a schedule's time steps.

    Args:
        pieces: the pieces of the motion; only the last may be endless.
        schedule: its time steps define the tick, their largest common divisor. The middle of a stage is a tick too
            where something acts there.

    Attributes:
        tick: length of a tick [s].
        steps: ticks of a step of each segment.
        halves: ticks from the start of a stage to its middle where something acts there (``ModelBase.acting``), else 0.
        entries: the phases; of an endless piece those of the first cycles.
        following: per entry the entry after it; -1 at the motion's end.
        total: number of ticks; infinite if the motion is endless.
        firsts: per piece, its first entry and its first tick.
        cycle, period: number of phases and of ticks of the endless piece's cycle; 0 if there is none.

    Raises:
        ProblemError: a phase is not a whole number of steps, or the time steps have no common divisor of at least
            0.1 ms.
    """

    def __init__(self, pieces: tuple[Piece, ...], schedule: Schedule) -> None:
        steps = [Fraction(segment.dt).limit_denominator(_FINEST) for segment in schedule.segments]
        acting = [bool(model_of(segment).acting) for segment in schedule.segments]
        apart = [step / 2 if each else step for step, each in zip(steps, acting, strict=True)]
        common = lcm(*(step.denominator for step in apart))
        unit = Fraction(gcd(*(int(step * common) for step in apart)), common)
        self.tick = float(unit)
        if self.tick < _SHORTEST - SAME_TIME:
            raise ProblemError(
                f"horizon: time steps have no common divisor - got {', '.join(f'{s.dt:g}' for s in schedule.segments)} "
                f"s, expected whole multiples of {_SHORTEST:g} s or more; choose time steps that divide each other"
            )
        self.steps = tuple(int(step / unit) for step in steps)
        self.halves = tuple(step // 2 if each else 0 for step, each in zip(self.steps, acting, strict=True))
        entries: list[Entry] = []
        self.firsts: list[tuple[int, int]] = []
        at = 0
        for number, piece in enumerate(pieces):
            self.firsts.append((len(entries), at))
            phases = piece.once + piece.cycle * (_CYCLES if piece.is_endless else piece.repeats or 0)
            for index, phase in enumerate(phases):
                length = round(phase.duration / self.tick)
                if abs(length * self.tick - phase.duration) > SAME_TIME or length < 1:
                    raise ProblemError(
                        f"phase '{phase.name}' ({phase.source}): not a whole number of steps - got {phase.duration:g} "
                        f"s, expected a multiple of {self.tick:g} s; change it, or the time step"
                    )
                t = at * self.tick
                entries.append(Entry(PlacedPhase(phase, number, index, t, t + length * self.tick), at, length))
                at += length
        self.entries = tuple(entries)
        self.cycle = len(pieces[-1].cycle) if pieces[-1].is_endless else 0
        last = len(entries) - self.cycle if self.cycle else -1
        self.following = (*range(1, len(entries)), last)
        self.total: float = inf if self.cycle else at
        self._starts = [entry.start for entry in entries]
        self.period = sum(entry.length for entry in entries[last:]) if self.cycle else 0

    def at(self, k: int) -> Place:
        """Return the place of a tick; on a boundary the later phase, at the motion's end the last one."""
        cycles = 0
        if self.cycle and k >= (first := self._starts[-self.cycle]):
            cycles = (k - first) // self.period
        entry = bisect_right(self._starts, k - cycles * self.period) - 1
        return Place(entry, entry + cycles * self.cycle, self._starts[entry] + cycles * self.period)

    def next(self, place: Place) -> Place:
        """Return the place of the phase after one that is not the motion's last."""
        return Place(self.following[place.entry], place.number + 1, place.start + self.entries[place.entry].length)

    def previous(self, place: Place) -> int:
        """Return the entry of the phase before one; -1 for the motion's first."""
        if self.cycle and place.number > place.entry and place.entry == len(self.entries) - self.cycle:
            return len(self.entries) - 1
        return place.entry - 1

    def cycles(self, place: Place) -> int:
        """Return how many cycles of an endless piece a place is beyond the entries."""
        return (place.number - place.entry) // self.cycle if self.cycle else 0

    def index(self, place: Place) -> int:
        """Return the index of a phase in its piece, cycles counted."""
        return self.entries[place.entry].placed.index + place.number - place.entry
