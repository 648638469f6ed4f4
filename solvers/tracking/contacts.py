"""Which points count as in contact: measured flags, debounced and merged with the plan's schedule.

``ContactFilter`` is the readable twin of ``template/contacts.h``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ShapeError, SolverError
from piaffe.ocp import SAME_TIME, LoweredMode

from .plan import PlanPhase

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MeasuredContacts:
    """How measured contact flags change the scheduled ones.

    A point touches once its flag has been 1 for ``debounce``, and leaves once it has been 0 for as long; in the plan's
    stance it leaves only after ``leave``, since feet bounce. In the plan's stance it is in contact from its touch on,
    not before; if there is none for ``late``, the schedule holds. In the plan's swing it is in contact if it touches
    within ``early`` before the plan's touchdown. At the plan's lift-off it leaves, whatever is measured.

    Args:
        debounce: time for which a flag must stay [s]; 0 for a single reading.
        leave: time for which a flag must be 0 in the plan's stance [s]; infinite: a point that has touched stays until
            the plan's lift-off.
        early: largest time by which a touchdown may be early [s].
        late: largest time by which a touchdown may be late [s].

    Raises:
        SolverError: a time is negative or NaN.
    """

    debounce: float = 0.002
    leave: float = 0.02
    early: float = 0.03
    late: float = np.inf

    def __post_init__(self) -> None:
        for each in fields(self):
            if not (value := getattr(self, each.name)) >= 0:
                raise SolverError(
                    f"measured contacts, {each.name}: out of range - got {value}, expected a time ≥ 0 s; change it"
                )


Contacts = Literal["schedule", "measured"] | MeasuredContacts


def contact_settings(contacts: Contacts, where: str) -> MeasuredContacts | None:
    """Return the settings of measured contacts; None for those of the schedule.

    Raises:
        SolverError: it is neither ``"schedule"`` nor ``"measured"`` nor settings.
    """
    if isinstance(contacts, MeasuredContacts):
        return contacts
    if contacts not in ("schedule", "measured"):
        raise SolverError(
            f"{where}: contacts are unknown - got {contacts!r}, expected 'schedule', 'measured' or MeasuredContacts; "
            "choose one"
        )
    return MeasuredContacts() if contacts == "measured" else None


def count_contacts(modes: Sequence[LoweredMode], slot: str, why: str | None) -> int:
    """Return the number of contact flags of some modes; 0 if one has none.

    Args:
        modes: the modes.
        slot: name of the slot with the flags.
        why: what needs the flags, for the message; None if nothing does.

    Raises:
        SolverError: flags are needed, and a mode has none, or the modes have different numbers of them.
    """
    sizes = [mode.layout.slots[slot].stop - mode.layout.slots[slot].start if slot in mode.layout.slots else 0
             for mode in modes]  # fmt: skip
    if len(set(sizes)) == 1 and sizes[0] > 0:
        return sizes[0]
    if why is not None:
        got = ", ".join(f"{size} of model '{mode.model.name}'" for mode, size in zip(modes, sizes, strict=True))
        raise SolverError(
            f"{why}: the models have no common contact flags - got {got} in slot '{slot}', expected one number > 0; "
            "name the slot of the flags in contact_slot, or leave them out"
        )
    return 0


def readings(contacts: ArrayLike, num: int, where: str) -> Array:
    """Return measured flags as an array (nf,).

    Raises:
        ShapeError: another number of them.
    """
    flags = np.asarray(contacts, dtype=float)
    if flags.shape != (num,):
        raise ShapeError(
            f"{where}: measured contacts have the wrong size - got shape {flags.shape}, expected ({num},); give one "
            "flag per point"
        )
    return flags


class ContactFilter:
    """The memory of measured contacts between ticks; it starts afresh if time goes back.

    Args:
        settings: the settings.
        num: number of flags nf.
    """

    def __init__(self, settings: MeasuredContacts, num: int) -> None:
        self._settings, self._last = settings, np.inf
        self._on, self._before = np.zeros(num, bool), np.zeros(num, bool)
        self._since, self._due = np.full(num, np.nan), np.full(num, np.nan)

    def __call__(self, measured: Array, scheduled: Array, soon: Array, t: float) -> Array:
        """Return which points are in contact at a time [s], (nf,), 0 or 1.

        Args:
            measured: flags as measured (nf,).
            scheduled: the plan's flags at this time (nf,).
            soon: 1 if the plan has the point in contact within ``early`` from now (nf,).
            t: time [s].
        """
        plan, read, settings = scheduled > 0.5, measured > 0.5, self._settings
        if t < self._last - SAME_TIME:
            self._on[:], self._before[:], self._since[:], self._due[:] = plan, plan, np.nan, np.nan
        self._last = t
        for i in range(len(plan)):
            if plan[i] != self._before[i]:
                self._before[i] = plan[i]
                if plan[i]:
                    self._due[i] = t
                else:
                    self._on[i], self._since[i], self._due[i] = False, np.nan, np.nan
            wait = settings.leave if plan[i] and not read[i] else settings.debounce
            if read[i] == self._on[i]:
                self._since[i] = np.nan
            else:
                self._since[i] = t if np.isnan(self._since[i]) else self._since[i]
                if t - self._since[i] >= wait - SAME_TIME:
                    self._on[i], self._since[i] = read[i], np.nan
            if t - self._due[i] >= settings.late - SAME_TIME:
                self._on[i], self._since[i], self._due[i] = True, np.nan, np.nan
            if self._on[i]:
                self._due[i] = np.nan
        return np.where(plan, self._on, self._on & (soon > 0.5)).astype(float)


def scheduled_soon(phases: Sequence[PlanPhase], place: tuple[int, int], until: float, slot: str) -> Array:
    """Return 1 for points that are in contact in a stage after a place that begins until a time [s], (nf,)."""
    i, k = place
    found = np.zeros_like(phases[i].p[k, phases[i].mode.layout.slots[slot]])
    for j, phase in enumerate(phases[i:]):
        for stage in range(k + 1 if j == 0 else 0, len(phase.controls)):
            if phase.times[stage] <= until + SAME_TIME:
                found = np.maximum(found, phase.p[stage, phase.mode.layout.slots[slot]])
    return np.asarray(found)
