"""A bound reference as CasADi functions of time and command: targets at any time, in constant time and memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError, ShapeError

from .frame import PlanarFrame
from .quantity import Quantity

Array = NDArray[np.float64]
Entries = tuple[tuple[Quantity, int], ...]


@dataclass(frozen=True, eq=False)
class ReferenceFunctions:
    """A bound reference for a controller that plans again and again, which may change the command on the way.

    The functions are of ``casadi.SX``, so that C can be generated from them. They are finite everywhere, and meant for
    values alone, not for derivatives. *Now* is the time of the last ``advance``, or of ``begin``. All times are
    relative to now, or to the start of a phase, so that numbers do not grow in an hour.

    What the reference remembers is the memory m. A *row* is the numbers of a phase of the piece; phi is the start of
    this phase minus now. On a boundary of phases, either phase may be given: positions and velocities are the same, and
    quantities that jump, such as forces, are those of the phase. ::

        start(x) → start                          what the reference begins with, from a state of the first model
        begin(start, c) → m                       memory at the start of the reference
        advance(m, dt, x, c, phi, row) → m        now is dt later, the measured state is x, the command is c;
                                                  phi and row are those of the phase that contains the new now
        move(m, motion) → m                       the reference moved by a planar motion (x, y, yaw)
        sample(tau, m, phi, row) → s              targets tau ≥ 0 after now; phi and row are those of the phase at tau
        pose(tau, m) → (x, y, yaw)                planar frame of the reference tau after now

    ``advance`` anchors the reference at the measured state. In which phase a motion is, the caller decides.

    All this is in the frame of a plan. If targets depend on where this frame is in the world, as footholds on a terrain
    do, ``begin``, ``advance`` and ``sample`` have one more input, the frame in the world: (x, y, yaw) [m, m, rad].

    Args:
        quantities: quantity and size of each entry of a sample s, in the order in which they are stacked.
        commands: names of the entries of the command c.
        command: the declared command, (len(commands),).
        schedule: function that returns the row of a phase by its index in the piece, cycles counted. From the second
            repetition on, the rows of a cycle repeat exactly: with n phases that run once and k phases of the cycle,
            those of index i ≥ n + 2 k and i + k are equal.
        pick: function that returns a CasADi function ``pick(s) → start``, as ``start`` from a sample of another
            reference with these entries; for a reference that begins at the end of another one.
        start, begin, advance, move, sample, pose: see above.

    Raises:
        ShapeError: the functions do not fit each other.
        ProblemError: ``pick`` gets entries in which a quantity is missing that the start needs.
    """

    quantities: Entries
    commands: tuple[str, ...]
    command: Array
    schedule: Callable[[int], Array]
    pick: Callable[[Entries], cs.Function]
    start: cs.Function
    begin: cs.Function
    advance: cs.Function
    move: cs.Function
    sample: cs.Function
    pose: cs.Function

    def __post_init__(self) -> None:
        m, c, row, x = self.num_memory, len(self.commands), self.num_schedule, self.start.numel_in(0)
        anchor = (3,) if self.in_world else ()
        for function, inputs, output in (
            (self.start, (x,), self.num_start),
            (self.begin, (self.num_start, c, *anchor), m),
            (self.advance, (m, 1, x, c, 1, row, *anchor), m),
            (self.move, (m, 3), m),
            (self.sample, (1, m, 1, row, *anchor), self.num_sample),
            (self.pose, (1, m), 3),
        ):
            got = tuple(function.numel_in(i) for i in range(function.n_in())), function.numel_out(0)
            if got != (inputs, output):
                raise ShapeError(
                    f"reference function '{function.name()}': wrong sizes - got inputs {got[0]} and output {got[1]}, "
                    f"expected {inputs} and {output}; make the functions fit each other"
                )
        for given, what in ((self.command, "command"), (self.schedule(0), "row of phase 0")):
            expected = c if what == "command" else row
            if np.shape(given) != (expected,):
                raise ShapeError(
                    f"reference functions, {what}: wrong size - got shape {np.shape(given)}, expected ({expected},); "
                    "give one number per entry"
                )

    @property
    def in_world(self) -> bool:
        """Whether targets depend on where the frame of a plan is in the world."""
        return bool(self.sample.n_in() > 4)

    def placed(self, function: cs.Function, *inputs: object, anchor: PlanarFrame) -> Array:
        """Return what ``begin``, ``advance`` or ``sample`` returns, as an array, in a frame that is at ``anchor``."""
        more = (np.array(anchor),) if self.in_world else ()
        return np.asarray(function(*inputs, *more), dtype=float).ravel()

    @property
    def num_sample(self) -> int:
        """Number of entries of a sample s."""
        return sum(size for _, size in self.quantities)

    @property
    def num_memory(self) -> int:
        """Number of entries of the memory m."""
        return int(self.begin.numel_out(0))

    @property
    def num_schedule(self) -> int:
        """Number of entries of a row."""
        return int(self.sample.numel_in(3))

    @property
    def num_start(self) -> int:
        """Number of entries of what the reference begins with."""
        return int(self.begin.numel_in(0))


def split_entries(values: cs.SX, entries: Entries) -> dict[Quantity, cs.SX]:
    """Return a stacked vector as expressions by quantity."""
    found, at = {}, 0
    for quantity, size in entries:
        found[quantity] = values[at : at + size]
        at += size
    return found


def require_entries(where: str, entries: Entries, needed: tuple[Quantity, ...]) -> None:
    """Raise ProblemError unless the entries contain quantities."""
    present = {quantity for quantity, _ in entries}
    for quantity in needed:
        if quantity not in present:
            raise ProblemError(
                f"{where}: cannot begin at the end of the reference before it - got one without '{quantity}', expected "
                "targets for it there; add them"
            )
