"""Where one motion may give way to another: at boundaries of phases where the feet of the other stand or land."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError
from piaffe.ocp import Horizon, LoweredMode

from ..tracking import CONTACT

Flags = NDArray[np.bool_]
Entries = NDArray[np.int32]


class Changes:
    """The phases with which motions begin after each other.

    A motion without an end gives way at the start of a phase of its endless piece; one with an end is finished first.
    There, another motion begins with a phase of which all feet have just stood or land now. A phase without feet fits
    only where all feet leave the ground, and only if no other phase fits. A motion begins with its first phase if that
    fits; one whose only piece is endless else with the first phase of its cycle that fits.

    Args:
        horizons: the motions by name.
        allowed: pairs (from, to) of names; None for all.

    Attributes:
        entries: per motion, the phase with which each other one begins at the start of each of its phases, and at its
            end; -1 where it does not, (phases + 1, motions).

    Raises:
        ProblemError: a motion never begins after another one, which it should.
    """

    def __init__(self, horizons: Mapping[str, Horizon], allowed: Collection[tuple[str, str]] | None = None) -> None:
        self._horizons, self._names = horizons, list(horizons)
        self._feet = {name: _feet_on_ground(horizon) for name, horizon in horizons.items()}
        pairs = {(a, b) for a in horizons for b in horizons if a != b}
        self.allowed = pairs if allowed is None else pairs & set(allowed)
        self.entries = [self._table(name) for name in horizons]
        for a, b in sorted(self.allowed):
            if not (self.entries[self._names.index(a)][self._late(a) :, self._names.index(b)] >= 0).any():
                raise self._never(a, b)

    def _late(self, name: str) -> int:
        """Return the first phase of a motion that comes again and again; its end, if it has one."""
        calendar = self._horizons[name].calendar
        return len(calendar.entries) - calendar.cycle

    def _table(self, name: str) -> Entries:
        horizon, feet = self._horizons[name], self._feet[name]
        count = len(horizon.calendar.entries)
        found = np.full((count + 1, len(self._names)), -1, dtype=np.int32)
        for other, to in enumerate(self._names):
            if (name, to) not in self.allowed:
                continue
            for entry in _exits(horizon):
                before, after = feet[entry - 1], feet[entry]
                found[entry, other] = self._entry(to, before, after)
            if not horizon.calendar.cycle:
                found[count, other] = self._entry(to, feet[-1], feet[-1])
        return found

    def _entry(self, to: str, before: Flags, after: Flags) -> int:
        """Return the first phase that fits at a boundary; -1 for none."""
        begins, feet, there = _begins(self._horizons[to]), self._feet[to], before | after
        if not there.size:
            return begins[0]
        for entry in begins:
            if feet[entry].any() and not (feet[entry] & ~there).any():
                return entry
        flights = [entry for entry in begins if not feet[entry].any()]
        return flights[0] if flights and not after.any() else -1

    def _never(self, a: str, b: str) -> ProblemError:
        calendars = self._horizons[a].calendar, self._horizons[b].calendar
        has = ", ".join(f"'{name}'" for name in dict.fromkeys(entry.phase.name for entry in calendars[0].entries))
        begins = _begins(self._horizons[b])
        wants = ", ".join(f"'{name}'" for name in dict.fromkeys(calendars[1].entries[i].phase.name for i in begins))
        return ProblemError(
            f"motions: '{b}' never begins after '{a}' - got phases {has} of '{a}', none of which ends where all feet "
            f"of {wants} stand or land; add a phase to one of them, or leave the pair out: "
            "changes=[('from', 'to'), ...] names those that are wanted"
        )


def _exits(horizon: Horizon) -> range:
    """Return the phases at whose start the motion may give way: those of its endless piece but the motion's first."""
    if not horizon.calendar.cycle:
        return range(0)
    return range(max(horizon.calendar.firsts[-1][0], 1), len(horizon.calendar.entries))


def _begins(horizon: Horizon) -> list[int]:
    """Return the phases with which a motion may begin, the first one first."""
    calendar = horizon.calendar
    if len(calendar.firsts) > 1 or not calendar.cycle:
        return [0]
    once = len(horizon.problem.motion.pieces[0].once)
    return list(dict.fromkeys([0, *range(once, once + calendar.cycle)]))


def _feet_on_ground(horizon: Horizon) -> Flags:
    """Return which feet are on the ground in each phase, (phases, nf); none if the first model has no such slot."""
    table, stores = horizon.tables.segments[0], horizon.tables.modes
    found = []
    for first, mode in zip(table.first, table.mode, strict=True):
        store = stores[int(mode)]
        slots = store.lowered.layout.slots if isinstance(store.lowered, LoweredMode) else {}
        row = store.rows[int(table.stage[int(first), 0])]
        found.append(row[slots[CONTACT]] > 0.5 if CONTACT in slots else np.zeros(0, dtype=bool))
    return np.array(found)
