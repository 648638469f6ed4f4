"""Tables: the numbers of the nodes of every phase that do not depend on time, one row for equal nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..compiler.compile import NOWHERE, RESETTING, RUNNING, Compilation
from ..compiler.guess import guess_controls, guess_states
from ..compiler.mode import LoweredMode
from ..compiler.numbers import Lowered
from ..compiler.timeline import HorizonPhase
from ..compiler.transition import LoweredTransition
from ..language import At, Node, Phase, Sample, model_of
from .calendar import Calendar
from .targets import Copies, TargetVector

Array = NDArray[np.float64]
Indices = NDArray[np.int32]

RESETS, LANDS, OWN = 1, 2, 4
"""Flags of a link: the transition changes the state; by an impact; by a reset of the user."""


class RowStore:
    """The different parameter rows of a mode or transition, without what they take from a sample, and their copies.

    Args:
        lowered: the mode or transition.
    """

    def __init__(self, lowered: Lowered) -> None:
        self.lowered = lowered
        self._rows: dict[bytes, int] = {}
        self._copies: dict[Copies, int] = {}

    def add(self, row: Array, copies: Copies) -> tuple[int, int]:
        """Return the indices of a row and of its copies; equal ones are stored once."""
        own = row.copy()
        own[list(copies.to)] = 0.0
        key = own.tobytes()
        return self._rows.setdefault(key, len(self._rows)), self._copies.setdefault(copies, len(self._copies))

    @cached_property
    def rows(self) -> Array:
        """The rows, (n, np); complete once all nodes are stored."""
        return np.array([np.frombuffer(key) for key in self._rows]).reshape(len(self._rows), self.lowered.layout.size)

    @cached_property
    def copies(self) -> tuple[Copies, ...]:
        """The copies."""
        return tuple(self._copies)


@dataclass(frozen=True, eq=False)
class SegmentTable:
    """Where the nodes of a segment have their numbers; a node is an entry of the calendar and a tick in it.

    Args:
        first: per entry, the index of its tick 0 in the tables; an entry of n ticks has n + 1 rows.
        mode: per entry, the index of its mode.
        stage: row and copies of a stage that acts at the tick, (rows, 2).
        end: the same of the last node of a part of the horizon, by whether it is the horizon's last, (2, rows, 2).
        link: transition, row, copies, and flags; by whether the next part is of the next
            segment, (2, rows, 4); transition -1 where there is none.
        controls: guess of the control of a stage (rows, nu).
    """

    first: Indices
    mode: Indices
    stage: Indices
    end: Indices
    link: Indices
    controls: Array


class Tables:
    """The numbers of the nodes of every phase and segment.

    Args:
        compilation: the compiler at work on the problem.
        calendar: the phases.
        targets: the sample vector.
        samples: per entry of the calendar, the samples at its ticks.

    Attributes:
        modes, transitions: the row stores.
        segments: a table per segment.
    """

    def __init__(
        self,
        compilation: Compilation,
        calendar: Calendar,
        targets: TargetVector,
        samples: Sequence[Sequence[Sample]],
    ) -> None:
        self._compilation, self._calendar, self._targets, self._samples = compilation, calendar, targets, samples
        self._modes: dict[LoweredMode, int] = {}
        self._links: dict[LoweredTransition, int] = {}
        self.modes: list[RowStore] = []
        self.transitions: list[RowStore] = []
        count = len(compilation.problem.schedule.segments)
        self.segments = tuple(self._segment(s) for s in range(count))

    def _segment(self, s: int) -> SegmentTable:
        entries = self._calendar.entries
        lengths = [entry.length + 1 for entry in entries]
        first = np.cumsum([0, *lengths])
        segment = self._compilation.problem.schedule.segments[s]
        total, nu = int(first[-1]), model_of(segment).control.nx
        table = SegmentTable(
            first=first[:-1].astype(np.int32),
            mode=np.zeros(len(entries), dtype=np.int32),
            stage=np.zeros((total, 2), dtype=np.int32),
            end=np.zeros((2, total, 2), dtype=np.int32),
            link=np.full((2, total, 4), -1, dtype=np.int32),
            controls=np.zeros((total, nu)),
        )
        for e in range(len(entries)):
            self._entry(s, e, int(first[e]), table)
        return table

    def _entry(self, s: int, e: int, at: int, table: SegmentTable) -> None:
        """Write the rows of one phase."""
        compilation, calendar = self._compilation, self._calendar
        segment, entry = compilation.problem.schedule.segments[s], calendar.entries[e]
        interval, phase, n, samples = entry.placed, entry.phase, entry.length, self._samples[e]
        after = calendar.following[e]
        following = calendar.entries[after].placed if after >= 0 else None
        inside = HorizonPhase(segment, interval, interval.start, 1, False, None)
        ending = HorizonPhase(segment, interval, interval.start, 1, True, following)
        mode = compilation.mode(inside)
        number = self._number(mode)
        table.mode[e] = number
        times = interval.start + calendar.tick * np.arange(n + 1.0)
        stages = [
            compilation.node(inside, float(t), interval, sample, is_end=False)
            for t, sample in zip(times, samples, strict=True)
        ]
        p = self._put(number, mode, segment.dt, stages, phase, RUNNING, table.stage[at : at + n + 1])
        ends = [
            compilation.node(ending if j == n else inside, float(t), interval, sample, is_end=True)
            for j, (t, sample) in enumerate(zip(times, samples, strict=True))
        ]
        for last in (False, True):
            own: set[At] = {"running", "end"} if last else {"running"}
            rows = table.end[int(last), at : at + n + 1]
            self._put(number, mode, segment.dt, ends[:n], phase, frozenset(own), rows[:n])
            self._put(number, mode, segment.dt, ends[n:], phase, frozenset(own | {"phase_end"}), rows[n:])
        self._links_of(s, e, at, table, mode, ends, samples, (inside, ending))
        states = guess_states(mode.model, samples, compilation.start)
        table.controls[at : at + n] = guess_controls(mode.model, stages[:n], states, mode.layout, p[:n])
        table.controls[at + n] = table.controls[at + n - 1]

    def _links_of(
        self, s: int, e: int, at: int, table: SegmentTable, mode: LoweredMode, ends: Sequence[Node],
        samples: Sequence[Sample], spans: tuple[HorizonPhase, HorizonPhase],
    ) -> None:  # fmt: skip
        """Write the transitions from a phase: at its end to the next phase, at any tick to the next segment."""
        compilation, calendar = self._compilation, self._calendar
        schedule, entry = compilation.problem.schedule, calendar.entries[e]
        interval, n, after = entry.placed, entry.length, calendar.following[e]
        successor = interval if after < 0 else calendar.entries[after].placed
        for to_next in (False, True):
            if to_next and s + 1 == len(schedule.segments):
                continue
            target = schedule.segments[s + 1 if to_next else s]
            for j in range(1 if to_next else n, n + 1):
                if j == n and after < 0:
                    continue  # the motion ends
                t = interval.start + j * calendar.tick
                ends_phase = j == n
                span = HorizonPhase(
                    spans[0].segment,
                    interval,
                    t - spans[0].segment.dt,
                    1,
                    ends_phase,
                    spans[1].following if ends_phase else None,
                )
                place = successor if ends_phase else interval
                follower = HorizonPhase(target, place, t, 1, False, None)
                lowered, p, resets, lands = compilation.transition(span, follower, mode, samples[j], interval)
                assert lowered is not None  # there is a follower
                if lowered not in self._links:
                    self._links[lowered] = len(self.transitions)
                    self.transitions.append(RowStore(lowered))
                number, user = self._links[lowered], ends_phase and entry.phase.reset is not None
                copies = self._copies(lowered, interval.phase, RESETTING if lands else NOWHERE)
                row, own = self.transitions[number].add(p, copies)
                table.link[int(to_next), at + j] = number, row, own, RESETS * resets + LANDS * lands + OWN * user

    def _number(self, mode: LoweredMode) -> int:
        if mode not in self._modes:
            self._modes[mode] = len(self.modes)
            self.modes.append(RowStore(mode))
        return self._modes[mode]

    def _put(
        self, number: int, mode: LoweredMode, dt: float, nodes: Sequence[Node], phase: Phase, here: frozenset[At],
        rows: Indices,
    ) -> Array:  # fmt: skip
        """Store the rows of nodes; return their parameters (n, np)."""
        if not nodes:
            return np.zeros((0, mode.layout.size))
        p = self._compilation.numbers.of_nodes(mode, dt, nodes, phase, here)
        copies = self._copies(mode, phase, here)
        for row, own in zip(rows, p, strict=True):
            row[:] = self.modes[number].add(own, copies)
        return p

    def _copies(self, lowered: Lowered, phase: Phase, here: frozenset[At]) -> Copies:
        """Return what the parameters of nodes take from a sample: targets, and slots that follow the motion."""
        slices = self._targets.slices
        to: list[int] = []
        of: list[int] = []
        parts: list[tuple[slice, str]] = []
        for each in self._compilation.numbers.tracked(lowered, phase, here):
            assert each.term.quantity is not None  # only tracked quantities have targets
            parts.append((each.part, each.term.quantity.path))
        for name, quantity in lowered.model.slots_from_motion.items():
            if name in lowered.layout.slots:
                parts.append((lowered.layout.slots[name], quantity.path))
        for part, path in parts:
            to += range(part.start, part.stop)
            of += range(slices[path].start, slices[path].stop)
        return Copies(tuple(to), tuple(of))


def tracked_quantities(compilation: Compilation, calendar: Calendar) -> dict[str, int]:
    """Return the paths of all quantities that nodes take from a sample, and their sizes."""
    found: dict[str, int] = {}
    wheres: tuple[frozenset[At], ...] = (RUNNING, frozenset({"running", "phase_end", "end"}))
    for segment in compilation.problem.schedule.segments:
        for entry in calendar.entries:
            mode = compilation.mode(HorizonPhase(segment, entry.placed, 0.0, 1, False, None))
            for here in wheres:
                for each in compilation.numbers.tracked(mode, entry.phase, here):
                    assert each.term.quantity is not None  # only tracked quantities have targets
                    found[each.term.quantity.path] = each.part.stop - each.part.start
            slots = {slot.name: slot.size for slot in mode.model.slots}
            for name, quantity in mode.model.slots_from_motion.items():
                found[quantity.path] = slots[name]
    return found
