"""The path: the targets of a motion over time, placed in the world."""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from math import inf, nextafter

import casadi as cs

from .model import Sample
from .piece import BoundReference, Piece, PlacedPhase, placed_phases
from .reference_functions import Entries
from .time import SAME_TIME


class AddedTargets(ABC):
    """Targets that a model adds to those of a motion, which follow from them: the ground below the feet."""

    @property
    @abstractmethod
    def origin(self) -> object:
        """What they come from; the models of one schedule that add targets must have equal ones."""

    @abstractmethod
    def at(self, t: float, interval: PlacedPhase, sample: Sample) -> Sample:
        """Return the added targets, which replace those of the same quantity.

        Args:
            t: time since the motion's start [s].
            interval: the phase, which selects the side where targets jump.
            sample: the motion's targets.
        """

    @property
    def kept(self) -> Entries:
        """Those of the added targets that :meth:`placed` needs, and their sizes; by default none."""
        return ()

    def placed(self, entries: Entries) -> cs.Function | None:
        """Return a function (s, anchor) → s that gives a sample the added targets that it has at another place.

        A controller that plans again and again moves samples with the frame of its plans. What the world is like there
        is another matter: this function replaces the targets that depend on it. By default there is none.

        Args:
            entries: quantities and sizes of the sample s, which is in the frame of a plan; anchor is this frame in the
                world, (x, y, yaw) [m, m, rad].
        """
        return None


@dataclass(frozen=True)
class PlacedPiece:
    """The start of a piece [s] and its reference, placed in the world."""

    start: float
    reference: BoundReference


@dataclass(frozen=True, eq=False)
class Path:
    """Targets over time.

    Args:
        pieces: the pieces of the motion, in order.
        placed: start and reference of each piece.
        added: what models add to the targets.
    """

    pieces: tuple[Piece, ...]
    placed: tuple[PlacedPiece, ...]
    added: tuple[AddedTargets, ...] = ()

    @property
    def duration(self) -> float:
        """Length of the motion [s]; infinite if it is cyclic."""
        return sum(piece.duration for piece in self.pieces)

    def sample(self, t: float, interval: PlacedPhase) -> Sample:
        """Return the targets at time t [s] in a phase; where targets jump, the phase selects the side of the jump."""
        piece = self.placed[interval.piece]
        sample = piece.reference.sample(t - piece.start, interval.index)
        for each in self.added:
            sample = {**sample, **each.at(t, interval, sample)}
        return sample

    def intervals(self, until: float) -> list[PlacedPhase]:
        """Return the phases that begin before a time [s]."""
        return self._phases.before(until)

    def interval_at(self, t: float) -> PlacedPhase:
        """Return the phase at time t; the later one on a boundary, the last one beyond the end."""
        return self._phases.at(t)

    def interval_before(self, t: float) -> PlacedPhase:
        """Return the phase that ends at or contains time t; the earlier one on a boundary."""
        return self._phases.last_before(t)

    @cached_property
    def _phases(self) -> _PhasesByTime:
        return _PhasesByTime(self.pieces)

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in self.__dict__.items() if name != "_phases"}  # it has an iterator


_CYCLES = 64  # cycles of an endless piece that are listed one by one; the place of later ones is computed


class _PhasesByTime:
    """The phases of a motion by time, in constant time and memory however late the time is.

    Bisection finds a phase among those of the first cycles, which are listed on first use. In later cycles of an
    endless piece, the phase follows from the number of the cycle.
    """

    def __init__(self, pieces: tuple[Piece, ...]) -> None:
        self._pieces = pieces
        self._rest = placed_phases(pieces)
        self._found = [next(self._rest)]
        self._starts = [self._found[0].start]
        *earlier, last = pieces
        self._cycle = last.cycle if last.is_endless else ()
        self._offsets = [0.0, *accumulate(phase.duration for phase in self._cycle)]  # the last one is the period
        self._begin = sum(piece.duration for piece in earlier) + sum(phase.duration for phase in last.once)
        self._listed = self._begin + _CYCLES * self._offsets[-1] if self._cycle else inf

    def at(self, t: float) -> PlacedPhase:
        if t > self._listed:
            return self._later(t + SAME_TIME)
        self._extend(t)
        return self._found[max(bisect_right(self._starts, t, key=lambda start: start - SAME_TIME), 1) - 1]

    def last_before(self, t: float) -> PlacedPhase:
        if t > self._listed:
            return self._later(nextafter(t - SAME_TIME, -inf))
        self._extend(t)
        return self._found[bisect_left(self._starts, t - SAME_TIME) - 1]

    def before(self, t: float) -> list[PlacedPhase]:
        self._extend(t)
        return self._found[: bisect_left(self._starts, t - SAME_TIME)]

    def _extend(self, t: float) -> None:
        while self._starts[-1] - SAME_TIME <= t and (interval := next(self._rest, None)):
            self._found.append(interval)
            self._starts.append(interval.start)

    def _later(self, t: float) -> PlacedPhase:
        """Return the last phase of the cycle that begins at time t or before."""
        size, period = len(self._cycle), self._offsets[-1]

        def start(count: int) -> float:  # of the phase with this number since the first cycle
            return self._begin + (count // size) * period + self._offsets[count % size]

        done = int((t - self._begin) // period)
        count = size * done + bisect_right(self._offsets[:-1], t - self._begin - done * period) - 1
        while start(count + 1) <= t:  # the quotient was rounded
            count += 1
        while start(count) > t:
            count -= 1
        index = len(self._pieces[-1].once) + count
        return PlacedPhase(self._cycle[count % size], len(self._pieces) - 1, index, start(count), start(count + 1))
