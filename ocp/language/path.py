"""The path: a motion placed in the world, as targets over time."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from functools import cached_property

from .model import Sample
from .piece import BoundReference, Piece, PlacedPhase, placed_phases
from .time import SAME_TIME


@dataclass(frozen=True)
class PlacedPiece:
    """A piece's start [s] and its reference, placed."""

    start: float
    reference: BoundReference


@dataclass(frozen=True, eq=False)
class Path:
    """Targets over time.

    Args:
        pieces: of the motion, in order.
        placed: the same pieces' starts and references.
    """

    pieces: tuple[Piece, ...]
    placed: tuple[PlacedPiece, ...]

    @property
    def duration(self) -> float:
        """Length of the motion [s]; infinite if it is cyclic."""
        return sum(piece.duration for piece in self.pieces)

    def sample(self, t: float, interval: PlacedPhase) -> Sample:
        """Return the targets at time t [s] as seen from within a phase (which decides the side of a jump)."""
        piece = self.placed[interval.piece]
        return piece.reference.sample(t - piece.start, interval.index)

    def intervals(self, until: float) -> list[PlacedPhase]:
        """Return the phases that begin before a time [s]."""
        return self._walk.before(until)

    def interval_at(self, t: float) -> PlacedPhase:
        """Return the phase at time t; the later one on a boundary, the last one beyond the end."""
        return self._walk.at(t)

    def interval_before(self, t: float) -> PlacedPhase:
        """Return the phase that ends at or contains time t; the earlier one on a boundary."""
        return self._walk.before(t)[-1]

    @cached_property
    def _walk(self) -> _Walk:
        return _Walk(self.pieces)


class _Walk:
    """The phases of a motion as far as they were asked for; finding one takes no longer the later it is."""

    def __init__(self, pieces: tuple[Piece, ...]) -> None:
        self._rest = placed_phases(pieces)
        self._found = [next(self._rest)]
        self._starts = [self._found[0].start]

    def at(self, t: float) -> PlacedPhase:
        self._reach(t)
        return self._found[max(bisect_right(self._starts, t, key=lambda start: start - SAME_TIME), 1) - 1]

    def before(self, t: float) -> list[PlacedPhase]:
        self._reach(t)
        return self._found[: bisect_left(self._starts, t - SAME_TIME)]

    def _reach(self, t: float) -> None:
        while self._starts[-1] - SAME_TIME <= t and (interval := next(self._rest, None)):
            self._found.append(interval)
            self._starts.append(interval.start)
