"""The path: a motion placed in the world, as targets over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .model import Sample
from .phase import Phase

if TYPE_CHECKING:
    from .motion import Motion
    from .reference import BoundReference


@dataclass(frozen=True)
class Interval:
    """A phase on the time axis: of which piece, which one in it, from when to when [s]."""

    phase: Phase
    piece: int
    index: int
    start: float
    end: float


@dataclass(frozen=True)
class PlacedPiece:
    """A piece's start [s] and its reference, placed."""

    start: float
    reference: BoundReference


@dataclass(frozen=True, eq=False)
class Path:
    """Targets over time."""

    motion: Motion
    pieces: tuple[PlacedPiece, ...]

    def sample(self, t: float, interval: Interval) -> Sample:
        """Return the targets at time t [s] as seen from within a phase (which decides the side of a jump)."""
        piece = self.pieces[interval.piece]
        return piece.reference.sample(t - piece.start, interval.index)

    def intervals(self, until: float) -> list[Interval]:
        """Return the phases that begin before a time [s]."""
        found = []
        for interval in self.motion.intervals():
            if interval.start >= until - 1e-9:
                break
            found.append(interval)
        return found

    def interval_at(self, t: float) -> Interval:
        """Return the phase at time t; the later one on a boundary, the last one beyond the end."""
        last = next(iter(self.motion.intervals()))
        for interval in self.motion.intervals():
            if t < interval.start - 1e-9:
                break
            last = interval
        return last

    def interval_before(self, t: float) -> Interval:
        """Return the phase that ends at or contains time t; the earlier one on a boundary."""
        return self.intervals(t)[-1]
