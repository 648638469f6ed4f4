"""The samples of a motion at the ticks of its calendar, and what a course needs of each piece."""

from __future__ import annotations

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError

from ..compiler.compile import Compilation
from ..language import ORIGIN, AddedTargets, Cost, PlanarFrame, Quantity, ReferenceFunctions, relative
from .calendar import Calendar
from .course import PieceTable
from .tables import tracked_quantities
from .targets import TargetVector

Array = NDArray[np.float64]

_PERIODIC = 1e-7  # largest difference of the samples of two cycles


class Samples:
    """The samples of a motion on its declared path.

    Args:
        compilation: the compiler at work on the problem.
        calendar: the phases.

    Attributes:
        at: per entry of the calendar, the samples at its ticks, its end included.
        targets: the quantities that nodes and guesses take from samples.
        packed: ``at`` as vectors, (length + 1, size) per entry.
    """

    def __init__(self, compilation: Compilation, calendar: Calendar) -> None:
        self._compilation, self._calendar, self._model = compilation, calendar, compilation.head
        self._functions = [piece.reference.functions() for piece in compilation.path.placed]
        self.at = [
            [
                compilation.path.sample(entry.placed.start + j * calendar.tick, entry.placed)
                for j in range(entry.length + 1)
            ]
            for entry in calendar.entries
        ]
        self.targets = self._target_vector()
        self.packed = [np.array([self.targets.pack(sample) for sample in own]) for own in self.at]
        self._add_slots()

    def piece(self, number: int) -> PieceTable:
        """Return what a course needs of a piece.

        Raises:
            ProblemError: the piece is endless, without functions, and its targets do not repeat.
        """
        calendar, frame_of = self._calendar, self._model.planar_frame
        entries = [e for e, entry in enumerate(calendar.entries) if entry.placed.piece == number]
        first, last = frame_of(self.at[entries[0]][0]), frame_of(self.at[entries[-1]][-1])
        functions = self._functions[number]
        self._refuse_unknown_ground(number, functions)
        if functions is None:
            none = np.zeros((len(entries), 0))
            return PieceTable(None, (), none, np.zeros(0), first, last, self._turn(number))
        start = np.zeros(0)
        if entries[0]:
            before = self.at[entries[0] - 1][-1]
            kinds = tuple((quantity, int(np.size(value))) for quantity, value in before.items())
            stacked = np.concatenate([np.ravel(value) for value in before.values()])
            start = np.asarray(functions.pick(kinds)(stacked), dtype=float).ravel()
        schedules = np.array([functions.schedule(calendar.entries[e].placed.index) for e in entries])
        places = self.targets.of_function(functions.quantities)
        return PieceTable(functions, places, schedules, start, first, last, ORIGIN)

    @property
    def placed(self) -> cs.Function | None:
        """What gives samples of tables the added targets that they have in the world; see ``AddedTargets.placed``."""
        entries = tuple(zip(self.targets.quantities, self.targets.sizes, strict=True))
        return next((each.placed(entries) for each in self._added), None)

    @property
    def _added(self) -> tuple[AddedTargets, ...]:
        """What models add to the targets of tables."""
        return self._compilation.path.added if None in self._functions else ()

    def _refuse_unknown_ground(self, number: int, functions: ReferenceFunctions | None) -> None:
        """Raise if a piece repeats its targets without end where the ground does not."""
        motion, added = self._compilation.problem.motion, self._compilation.path.added
        if not added or functions is not None or not motion.pieces[number].is_endless:
            return
        first = motion.pieces[number].phases[0]
        raise ProblemError(
            f"motion, phase '{first.name}' ({first.source}): repeats where the ground does not - got a cycle without "
            f"end of keyframes or a trajectory on {added[0].origin}, expected a finite motion, or a gait, which "
            "follows the ground; choose a number of cycles with .cycles(n), or leave terrain out of the model"
        )

    def _target_vector(self) -> TargetVector:
        models = self._compilation.models
        sizes = tracked_quantities(self._compilation, self._calendar)
        known = {quantity.path: quantity for own in self.at for quantity in own[0]}
        for model in models:
            sizes |= {block.quantity.path: block.nx for block in model.state.blocks}
            known |= {block.quantity.path: block.quantity for block in model.state.blocks}
            known |= {quantity.path: quantity for quantity in model.slots_from_motion.values()}
        for added in self._added:
            sizes |= {quantity.path: size for quantity, size in added.kept}
            known |= {quantity.path: quantity for quantity, _ in added.kept}
        for term in self._compilation.terms:  # a transition may follow the motion, too: the impulses of a landing
            path = term.quantity.path if isinstance(term, Cost) and term.quantity is not None else ""
            if path in known and path not in sizes:
                sizes[path] = next(np.size(own[0][known[path]]) for own in self.at if known[path] in own[0])
        start = {quantity.path: value for quantity, value in self._compilation.start.items()}
        quantities = tuple(known.get(path, Quantity(path)) for path in sizes)  # the tables name a missing one
        initial = tuple(
            np.broadcast_to(np.asarray(start.get(q.path, np.eye(4)[0] if q.kind == "rotation" else 0.0)), (size,))
            for q, size in zip(quantities, sizes.values(), strict=True)
        )
        return TargetVector(quantities, tuple(sizes.values()), initial)

    def _add_slots(self) -> None:
        """Write what a model's slots take from the motion where a sample has no such quantity."""
        slices = self.targets.slices
        for model in self._compilation.models:
            for name, quantity in model.slots_from_motion.items():
                for entry, samples, packed in zip(self._calendar.entries, self.at, self.packed, strict=True):
                    for sample, row in zip(samples, packed, strict=True):
                        if quantity not in sample:
                            node = self._compilation.plain_node(model, entry.placed, sample)
                            row[slices[quantity.path]] = model.node_parameters(node)[name]

    def _turn(self, number: int) -> PlanarFrame:
        """Return the planar motion of a cycle of an endless piece; raise if its targets do not repeat."""
        entries, n = self._calendar.entries, self._calendar.cycle
        if not self._compilation.problem.motion.pieces[number].is_endless:
            return ORIGIN
        frames = [self._model.planar_frame(self.at[len(entries) - i * n][0]) for i in (2, 1)]
        turn = relative(frames[1], frames[0])
        for e in range(len(entries) - n, len(entries)):
            difference = np.abs(self.targets.moved(self.packed[e - n], turn) - self.packed[e]).max(initial=0.0)
            if difference > _PERIODIC:
                phase = entries[e].phase
                raise ProblemError(
                    f"phase '{phase.name}' ({phase.source}): its targets do not repeat - got a difference of "
                    f"{difference:.3g} between two cycles, expected cycles that are equal up to a motion in the plane; "
                    "choose a number of cycles with .cycles(n), or a reference that repeats"
                )
        return turn
