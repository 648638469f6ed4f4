"""The path: the targets of a motion over time, placed in the world."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from functools import cached_property

from .model import Sample
from .piece import BoundReference, Piece, PlacedPhase, placed_phases
from .time import SAME_TIME


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
    """

    pieces: tuple[Piece, ...]
    placed: tuple[PlacedPiece, ...]

    @property
    def duration(self) -> float:
        """Length of the motion [s]; infinite if it is cyclic."""
        return sum(piece.duration for piece in self.pieces)

    def sample(self, t: float, interval: PlacedPhase) -> Sample:
        """Return the targets at time t [s] in a phase; where targets jump, the phase selects the side of the jump."""
        piece = self.placed[interval.piece]
        return piece.reference.sample(t - piece.start, interval.index)

    def intervals(self, until: float) -> list[PlacedPhase]:
        """Return the phases that begin before a time [s]."""
        return self._phases.before(until)

    def interval_at(self, t: float) -> PlacedPhase:
        """Return the phase at time t; the later one on a boundary, the last one beyond the end."""
        return self._phases.at(t)

    def interval_before(self, t: float) -> PlacedPhase:
        """Return the phase that ends at or contains time t; the earlier one on a boundary."""
        return self._phases.before(t)[-1]

    @cached_property
    def _phases(self) -> _PhasesByTime:
        return _PhasesByTime(self.pieces)


class _PhasesByTime:
    """The phases of a motion up to the latest time that was requested; bisection finds the phase at a time."""

    def __init__(self, pieces: tuple[Piece, ...]) -> None:
        self._rest = placed_phases(pieces)
        self._found = [next(self._rest)]
        self._starts = [self._found[0].start]

    def at(self, t: float) -> PlacedPhase:
        self._extend(t)
        return self._found[max(bisect_right(self._starts, t, key=lambda start: start - SAME_TIME), 1) - 1]

    def before(self, t: float) -> list[PlacedPhase]:
        self._extend(t)
        return self._found[: bisect_left(self._starts, t - SAME_TIME)]

    def _extend(self, t: float) -> None:
        while self._starts[-1] - SAME_TIME <= t and (interval := next(self._rest, None)):
            self._found.append(interval)
            self._starts.append(interval.start)
