"""Pieces of a motion: phases that share a reference, and the base classes of references."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import count

from .frame import PlanarFrame
from .model import ModelBase, Sample
from .phase import Phase
from .reference_functions import ReferenceFunctions


class BoundReference(ABC):
    """A reference placed in the world for one model."""

    @abstractmethod
    def sample(self, t: float, phase: int) -> Sample:
        """Return the targets at a time.

        Args:
            t: time since the piece's start [s].
            phase: index of the phase in the piece, cycles counted; where targets jump, it selects the side of the jump.
        """

    def functions(self) -> ReferenceFunctions | None:
        """Return the reference as CasADi functions of time and command; None, unless a class has them."""
        return None


class Reference(ABC):
    """A source of targets that is not yet placed in the world for a model."""

    @abstractmethod
    def bind(self, model: ModelBase, piece: Piece, start: Sample, frame: PlanarFrame) -> BoundReference:
        """Place the reference.

        Args:
            model: the first model of the schedule.
            piece: the piece of motion that has this reference.
            start: targets at the piece's start, in the world.
            frame: planar frame (x, y, yaw) [m, m, rad] in which the piece is placed; the origin for the first piece.
        """


@dataclass(frozen=True, eq=False)
class Piece:
    """Phases that share a reference.

    Args:
        once: phases that run once, before the cycle (all of them if there is none).
        cycle: phases that repeat.
        repeats: number of repetitions; None for no end.
        reference: source of the targets.
    """

    once: tuple[Phase, ...]
    cycle: tuple[Phase, ...]
    repeats: int | None
    reference: Reference

    @property
    def is_endless(self) -> bool:
        """Whether the cycle repeats without end."""
        return bool(self.cycle) and self.repeats is None

    @property
    def phases(self) -> tuple[Phase, ...]:
        """All phases in order; of an endless piece those up to the end of the first cycle."""
        return self.once + self.cycle * (1 if self.repeats is None else self.repeats)

    def unrolled(self) -> Iterator[Phase]:
        """Yield the phases, without end if the piece is endless."""
        yield from self.once
        for _ in count() if self.repeats is None and self.cycle else range(self.repeats or 0):
            yield from self.cycle

    @property
    def duration(self) -> float:
        """Length [s]; infinite if endless."""
        return float("inf") if self.is_endless else sum(phase.duration for phase in self.phases)


@dataclass(frozen=True)
class PlacedPhase:
    """A phase on the time axis: index of its piece, its index in the piece, its start and end [s]."""

    phase: Phase
    piece: int
    index: int
    start: float
    end: float


def placed_phases(pieces: Iterable[Piece]) -> Iterator[PlacedPhase]:
    """Yield the phases of pieces on the time axis, without end if the last piece is endless."""
    t = 0.0
    for number, piece in enumerate(pieces):
        for index, phase in enumerate(piece.unrolled()):
            yield PlacedPhase(phase, number, index, t, t + phase.duration)
            t += phase.duration
