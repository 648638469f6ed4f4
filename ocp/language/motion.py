"""Motions: sequences of phases with their targets, composed by ``+`` and repeated by ``cycles``."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from piaffe.errors import ProblemError
from piaffe.html import html_table

from .frame import ORIGIN
from .model import ModelBase, Sample
from .path import Path, PlacedPiece
from .phase import Phase
from .piece import Piece, PlacedPhase, Reference, placed_phases
from .reference import FromTrajectory, Keyframes
from .source import Source, caller
from .trajectory import SCHEDULED, Trajectory
from .user_input import brief


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Motion:
    """A sequence of phases and their targets.

    Args:
        *phases: the phases in order.
        cyclic: whether they repeat without end (choose a number with ``cycles``).
        reference: the source of the targets; by default the phases' keyframes.
        once: phases to run once before a cyclic motion's first cycle.
    """

    pieces: tuple[Piece, ...]
    source: Source

    def __init__(
        self,
        *phases: Phase,
        cyclic: bool = False,
        reference: Reference | None = None,
        once: tuple[Phase, ...] = (),
    ) -> None:
        object.__setattr__(self, "source", caller())
        if not phases:
            raise ProblemError(f"motion ({self.source}): no phases - got none, expected at least one ocp.Phase; add it")
        for phase in (*once, *phases):
            if not isinstance(phase, Phase):
                raise ProblemError(
                    f"motion ({self.source}): not a phase - got {brief(phase)}, expected an ocp.Phase; make one"
                )
        if reference is not None:
            self._check_reference(reference, (*once, *phases))
        if not cyclic:
            once, phases = once + phases, ()
        piece = Piece(once, phases, None if cyclic else 0, reference or Keyframes())
        object.__setattr__(self, "pieces", (piece,))

    def __repr__(self) -> str:
        names = [phase.name for piece in self.pieces for phase in piece.phases]
        shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
        length = "without end" if self.pieces[-1].is_endless else f"{self.duration:g} s"
        return f"Motion({len(names)} phases, {length}: {shown})"

    def _repr_html_(self) -> str:
        phases = [phase for piece in self.pieces for phase in piece.phases]
        return html_table(repr(self), ("phase", "mode", "duration [s]"), [(p.name, p.mode, p.duration) for p in phases])

    def _check_reference(self, reference: object, phases: tuple[Phase, ...]) -> None:
        """Raise if the reference is not an ``ocp.Reference``, or if phases have keyframes that it does not read."""
        if not isinstance(reference, Reference):
            raise ProblemError(
                f"motion ({self.source}): reference is unusable - got {brief(reference)}, expected one like "
                "ocp.FromArrays; make one, or leave it out to follow the phases' keyframes"
            )
        for phase in phases:
            if phase.target is not None and not isinstance(reference, Keyframes):
                raise ProblemError(
                    f"phase '{phase.name}' ({phase.source}): its keyframe applies nowhere - got a motion whose targets "
                    f"come from {type(reference).__name__}, expected one source of targets; remove the keyframe or the "
                    "reference"
                )

    @classmethod
    def _of(cls, pieces: tuple[Piece, ...], source: Source) -> Motion:
        motion = object.__new__(cls)
        object.__setattr__(motion, "pieces", pieces)
        object.__setattr__(motion, "source", source)
        return motion

    @classmethod
    def from_trajectory(cls, trajectory: Trajectory, modes: dict[str, Hashable] | None = None) -> Motion:
        """Return the motion of a trajectory: its phases, its modes and, as targets, its states and controls.

        Args:
            trajectory: e.g. ``solution.trajectory``.
            modes: phase name → mode that replaces the stored text, for models whose modes are not text.
        """
        replaced = modes or {}
        for part in trajectory.phases:
            if part.mode == SCHEDULED and part.name not in replaced:
                raise ProblemError(
                    f"motion ({caller()}): phase '{part.name}' of the trajectory spans several modes - got a phase of "
                    f"model '{part.model}', which has one phase for all modes, expected phases of one mode each; use "
                    "only the phases before it, or give its mode in modes="
                )
        phases = [Phase(part.name, replaced.get(part.name, part.mode), part.duration) for part in trajectory.phases]
        return cls(*phases, reference=FromTrajectory(trajectory))

    @classmethod
    def from_solution(cls, solution: object, modes: dict[str, Hashable] | None = None) -> Motion:
        """Return the motion of a solution; see :meth:`from_trajectory`."""
        return cls.from_trajectory(solution.trajectory, modes)  # type: ignore[attr-defined]  # any solver's solution

    def __add__(self, other: Motion) -> Motion:
        if not isinstance(other, Motion):
            raise ProblemError(
                f"motion ({caller()}): can be followed by a motion only - got {type(other).__name__}, expected an "
                "ocp.Motion; write ocp.Motion(phase, ...)"
            )
        if self.pieces[-1].is_endless:
            raise ProblemError(
                f"motion ({self.source}): an endless motion cannot be followed by another - got a cyclic motion, "
                "expected a finite one; choose a number with .cycles(n)"
            )
        return Motion._of(self.pieces + other.pieces, self.source)

    def cycles(self, n: int) -> Motion:
        """Return the motion with n repetitions of its cycle; a motion that is not cyclic is repeated as a whole."""
        if not isinstance(n, int | np.integer) or n < 1:
            raise ProblemError(
                f"motion ({self.source}): cycles is out of range - got {n!r}, expected a whole number, at least 1; "
                "give one"
            )
        last = self.pieces[-1]
        if last.cycle:
            return Motion._of((*self.pieces[:-1], replace(last, repeats=n)), self.source)
        return Motion._of(self.pieces * n, self.source)

    @property
    def duration(self) -> float:
        """Length [s]; infinite if cyclic."""
        return sum(piece.duration for piece in self.pieces)

    def intervals(self) -> Iterator[PlacedPhase]:
        """Yield the phases on the time axis, without end if the motion is endless."""
        return placed_phases(self.pieces)

    def bind(self, models: tuple[ModelBase, ...], start: Sample) -> Path:
        """Place the motion in the world for the models of a schedule, from the sample ``start``."""
        model = models[0]
        placed: list[PlacedPiece] = []
        t, frame = 0.0, ORIGIN
        for number, piece in enumerate(self.pieces):
            if isinstance(piece.reference, Keyframes):
                reference = piece.reference.bind_all(models, piece, start, frame)
            else:
                reference = piece.reference.bind(model, piece, start, frame)
            placed.append(PlacedPiece(t, reference))
            if number < len(self.pieces) - 1:
                start = reference.sample(piece.duration, len(piece.phases) - 1)
                frame = model.planar_frame(start)
                t += piece.duration
        return Path(self.pieces, tuple(placed))
