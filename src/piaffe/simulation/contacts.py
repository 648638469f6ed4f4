"""Planned contacts of any plan, and how early or late feet touch down."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import SAME_TIME

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_BOUNCE = 0.010  # [s], a shorter time off the ground is a part of a contact


def planned_contacts(low: Any, plan: Any = None) -> Callable[[float], Array] | None:
    """Return a function of time that returns which feet a plan has on the ground, 1 or 0, (nf,).

    The first of these is taken: ``low.contacts(t)``, ``plan.contacts(t)``, and the slot ``"contact"`` in the parameters
    of ``plan.phases``, as of ``solvers.PlanPhase``, up to the first phase without this slot.

    Args:
        low: the low level.
        plan: its plan; by default ``low.plan``.

    Returns:
        None if there is none of these.
    """
    plan = getattr(low, "plan", None) if plan is None else plan
    for each in (low, plan):
        contacts = getattr(each, "contacts", None)
        if callable(contacts):
            return lambda t: np.asarray(contacts(t), dtype=float)
    phases = list(takewhile(lambda phase: "contact" in phase.mode.layout.slots, getattr(plan, "phases", ())))
    return _Table(phases) if phases else None


class _Table:
    """Contacts of the stages of a plan's phases; before and after the plan, those of its first and last stage."""

    def __init__(self, phases: Sequence[Any]) -> None:
        self._starts = np.concatenate([np.asarray(phase.times[:-1], dtype=float) for phase in phases])
        self._flags = np.concatenate([phase.p[:, phase.mode.layout.slots["contact"]] for phase in phases])

    def __call__(self, t: float) -> Array:
        row = int(np.searchsorted(self._starts, t + SAME_TIME, side="right")) - 1
        return np.asarray(self._flags[max(row, 0)])


@dataclass(frozen=True)
class Touchdown:
    """A planned touchdown.

    Args:
        foot: name of the foot.
        time: planned [s].
        late: actual time minus planned time [s], negative if early; None if the foot did not leave the ground before
            it, or did not touch down in its stance.
    """

    foot: str
    time: float
    late: float | None


def touchdowns(times: Array, planned: Array, loaded: Flags, feet: Sequence[str]) -> tuple[Touchdown, ...]:
    """Return the planned touchdowns, in the order of time, and how early or late they were.

    A foot that leaves the ground for less than 10 ms bounces; this is no liftoff.

    Args:
        times: (T,) [s].
        planned: planned contacts, 1 or 0, NaN where they are not known (T, nf).
        loaded: whether a foot is on the ground (T, nf).
        feet: names of the feet.
    """
    found = []
    for j, foot in enumerate(feet):
        known, rests = np.isfinite(planned[:, j]), planned[:, j] > 0.5
        on = _without_bounces(times, loaded[:, j])
        begins = np.flatnonzero(~rests[:-1] & rests[1:] & known[:-1] & known[1:]) + 1
        changes = np.flatnonzero(np.diff(rests)) + 1
        for i in begins:
            first = max(changes[changes < i], default=0)
            last = min(changes[changes > i], default=len(times))
            found.append(Touchdown(foot, float(times[i]), _lateness(times, on, int(first), int(i), int(last))))
    return tuple(sorted(found, key=lambda each: each.time))


def _lateness(times: Array, on: Flags, first: int, i: int, last: int) -> float | None:
    """Return how late a foot touches down whose swing is first … i and whose stance is i … last."""
    if on[i]:
        off = np.flatnonzero(~on[first:i])
        return float(times[first + off[-1] + 1] - times[i]) if len(off) else None
    touches = np.flatnonzero(on[i:last])
    return float(times[i + touches[0]] - times[i]) if len(touches) else None


def _without_bounces(times: Array, on: Flags) -> Flags:
    """Return the flags without short times off the ground between two contacts."""
    filled = on.copy()
    ends = np.flatnonzero(on[:-1] & ~on[1:])
    starts = np.flatnonzero(~on[:-1] & on[1:]) + 1
    for end in ends:
        after = starts[starts > end]
        if len(after) and times[after[0]] - times[end + 1] < _BOUNCE - SAME_TIME:
            filled[end : after[0]] = True
    return filled
