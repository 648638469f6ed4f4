"""The numbers of one phase of a gait that its functions need: stances around the phase, and contact forces."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import SAME_TIME

from .footsteps import ContactSchedule

Array = NDArray[np.float64]

FAR = 1e6
"""In place of infinite times [s]."""


@dataclass(frozen=True)
class FootRow:
    """Stances of a foot about a phase, as numbers or expressions; times are relative to the phase's start [s].

    The *present* stance is the one in this phase or, for a foot in the air, the one before.

    Args:
        before: touchdown of the stance before the present one.
        touchdown: touchdown of the present stance.
        liftoff: its liftoff.
        length: its duration; 0 for a foot that stays on the ground.
        next_touchdown: touchdown of the stance after the present one.
        next_length: its duration; 0 for a foot that stays on the ground.
        lands: 1 if there is such a stance, else 0 (and the two times are 0).
        force: vertical contact force in this phase [N].
    """

    before: Any
    touchdown: Any
    liftoff: Any
    length: Any
    next_touchdown: Any
    next_length: Any
    lands: Any
    force: Any


_SIZE = len(fields(FootRow))


def row_size(num_feet: int) -> int:
    """Return the number of entries of a row."""
    return _SIZE * num_feet


def rows_of(row: cs.SX) -> list[FootRow]:
    """Return a row as expressions, by foot."""
    return [FootRow(*cs.vertsplit(row[at : at + _SIZE])) for at in range(0, row.numel(), _SIZE)]


def phase_row(schedule: ContactSchedule, index: int, forces: Array) -> Array:
    """Return the row of a phase, (8 nf,).

    From the second repetition of the cycle on, the rows repeat. What lies before the cycle before the last then counts
    as infinitely long ago; this concerns only feet that stand, or are in the air, in the whole cycle.

    Args:
        schedule: contacts over time.
        index: index of the phase, cycles counted.
        forces: vertical contact forces in this phase, (nf,) [N].
    """
    once, cycle = len(schedule.once), len(schedule.cycle)
    repeats = bool(cycle) and index >= once + 2 * cycle
    index = once + 2 * cycle + (index - once) % cycle if repeats else index if cycle else min(index, once - 1)
    durations = [duration for duration, _ in schedule.once + 3 * schedule.cycle]
    start, end = sum(durations[:index]), sum(durations[: index + 1])
    oldest = sum(durations[:once]) + SAME_TIME if repeats else -FAR
    feet = []
    for foot, force in enumerate(forces):
        stances = schedule.stances(foot, end)
        i = int(np.searchsorted(stances[:, 0], start + SAME_TIME, side="right")) - 1
        lands = i + 1 < len(stances)
        times = np.array([stances[i - 1, 0] if i else -np.inf, *stances[i], stances[i + 1, 0] if lands else start])
        relative = np.where(times <= oldest, -FAR, np.clip(times - start, -FAR, FAR))
        length, next_length = (
            liftoff - touchdown if np.isfinite(liftoff - touchdown) else 0.0
            for touchdown, liftoff in (stances[i], stances[i + 1] if lands else stances[i])
        )
        feet.append(
            FootRow(
                before=relative[0],
                touchdown=relative[1],
                liftoff=relative[2],
                length=length,
                next_touchdown=relative[3] if lands else 0.0,
                next_length=next_length if lands else 0.0,
                lands=lands,
                force=force,
            )
        )
    return np.array([[getattr(foot, field.name) for field in fields(FootRow)] for foot in feet], dtype=float).ravel()
