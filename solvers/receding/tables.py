"""The tables of ``ocp.Horizon`` in memory for C, and the libraries that work on them."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import TIME_STEP, Horizon, LoweredMode, LoweredTransition

from . import structs as s
from .code import HorizonCode, commanded
from .functions import spaces
from .keeper import Keeper

Array = NDArray[np.float64]


class HorizonMemory(Keeper):
    """The tables of a horizon in C.

    Args:
        horizon: the problem at any time.
        code: the libraries, which several horizons may share.
        number: of the horizon among those of the code.

    Attributes:
        modes, links: the modes and transitions, in the order of their numbers.
        code: the libraries. commands: the commands that the functions of all pieces read.
        c: the structure.
    """

    def __init__(self, horizon: Horizon, code: HorizonCode, number: int = 0) -> None:
        super().__init__()
        self.horizon, self.code, tables = horizon, code, horizon.tables
        self.modes = tuple(each.lowered for each in tables.modes if isinstance(each.lowered, LoweredMode))
        self.links = tuple(each.lowered for each in tables.transitions if isinstance(each.lowered, LoweredTransition))
        first = code.firsts[number]
        self.commands: Array = code.commands[first : first + len(self.commanded({}))]
        self._names = code.names[number]
        self.c = self._tables()

    def commanded(self, commands: Mapping[str, float]) -> Array:
        """Return the commands of all pieces, one piece after another: values by name, else the declared ones."""
        return commanded(self.horizon, commands)

    def _address(self, name: str) -> int | None:
        """Return the address of a generated function; None if there is no such function."""
        if name not in self._names:
            return None
        return ct.cast(getattr(self.code.library, self._names[name]), ct.c_void_p).value

    def _copies(self, copies: Any) -> s.Copies:
        return s.Copies(len(copies.to), self.ints(copies.to), self.ints(copies.of))

    def _tables(self) -> s.HorizonTables:
        horizon = self.horizon
        calendar, tables = horizon.calendar, horizon.tables
        own, code = spaces(horizon), self.code
        segments = []
        for i, (segment, table) in enumerate(zip(horizon.problem.schedule.segments, tables.segments, strict=True)):
            window = horizon.layout.windows[i]
            segments.append(s.Segment(
                calendar.steps[i], calendar.halves[i], -1 if window is None else window, int(horizon.layout.cut[i]),
                own.index(horizon.models[i]), len(table.stage), segment.dt, self.ints(table.first),
                self.ints(table.mode), self.ints(table.stage), self.ints(table.end), self.ints(table.link),
                self.doubles(table.controls), self._copies(horizon.state_copies[i]),
                self._copies(horizon.acting[i]),
            ))  # fmt: skip
        entries = [
            s.Entry(entry.placed.piece, entry.length, following, entry.start, height)
            for entry, following, height in zip(
                calendar.entries, calendar.following, horizon.falls.heights, strict=True
            )
        ]
        samples = self._samples()
        frames = [
            horizon.models[0].planar_frame(horizon.targets.unpack(row))
            for row in samples
        ]  # fmt: skip
        modes = [self._store(i, store, "mode") for i, store in enumerate(tables.modes)]
        links = [self._store(i, store, "transition") for i, store in enumerate(tables.transitions)]
        of_modes = [self._table(f"mode{code.modes.index(each)}_table") for each in self.modes]
        of_links = [self._table(f"transition{code.links.index(each)}_table") for each in self.links]
        solver = code.solver.loaded
        return s.HorizonTables(
            tick=calendar.tick, total=-1 if np.isinf(calendar.total) else int(calendar.total),
            period=calendar.period, num_entries=len(entries), cycle=calendar.cycle,
            num_pieces=len(horizon.courses.pieces), num_segments=len(segments), num_targets=horizon.targets.size,
            num_modes=len(modes), num_transitions=len(links), entries=self.array(s.Entry, entries),
            segments=self.array(s.Segment, segments), pieces=self.array(s.Piece, self._pieces()),
            spaces=self.array(s.Space, [
                s.Space(self._address(f"space{i}_state"), self._address(f"space{i}_control"), m.state.nx, m.control.nx)
                for i, m in enumerate(own)
            ]),
            samples=self.doubles(samples), frames=self.doubles(frames),
            initial=self.doubles(np.concatenate([np.zeros(0), *map(np.ravel, horizon.targets.initial)])),
            modes=self.array(s.Store, modes), transitions=self.array(s.Store, links),
            mode_tables=self.array(ct.c_void_p, of_modes), transition_tables=self.array(ct.c_void_p, of_links),
            moved_sample=self._address("moved_sample"), pose=self._address("pose"), placed=self._address("placed"),
            solve=ct.cast(solver.piaffe_solve, ct.c_void_p), policy=ct.cast(solver.piaffe_policy, ct.c_void_p),
            clock=ct.cast(solver.piaffe_now, ct.c_void_p),
            adapt=ct.cast(solver.piaffe_adapt, ct.c_void_p),
            follows=int(horizon.falls.follows),
            num_lanes=3 + max(  # functions that do not depend on the plan's place in the world get it, too
                sum(f.numel_in(i) for i in range(f.n_in())) + sum(f.numel_out(i) for i in range(f.n_out()))
                for f in code.functions.values()
            ),
            num_work=max(code.work.values()),
            followed=self.ints([code.followed.index(mode) if mode in code.followed else -1 for mode in self.modes]),
        )  # fmt: skip

    def _samples(self) -> Array:
        """Return the samples at the ticks of all entries up to the last one that reads them, (rows, num_targets)."""
        courses, entries = self.horizon.courses, self.horizon.calendar.entries
        read = [i for i, entry in enumerate(entries) if courses.pieces[entry.placed.piece].functions is None]
        return np.concatenate([np.zeros((0, self.horizon.targets.size)), *courses.tables[: max(read, default=-1) + 1]])

    def _table(self, name: str) -> int:
        return ct.addressof(ct.c_char.in_dll(self.code.solver.loaded, name))

    def _store(self, i: int, store: Any, kind: str) -> s.Store:
        copies = self.array(s.Copies, [self._copies(each) for each in store.copies])
        return s.Store(
            self.doubles(store.rows), copies, self._address(f"{kind}{i}_weights"),
            self._address(f"{kind}{i}_end_weights"), self._address(f"{kind}{i}_fall"),
            store.lowered.layout.slices[TIME_STEP].start,
        )  # fmt: skip

    def _pieces(self) -> list[s.Piece]:
        found, told = [], 0
        for i, (piece, (entry, tick)) in enumerate(
            zip(self.horizon.courses.pieces, self.horizon.calendar.firsts, strict=True)
        ):
            of = piece.functions
            command = self.commands[told:].ctypes.data
            sizes = (0,) * 5 if of is None else (
                of.num_memory, of.num_sample, of.num_schedule, of.num_start, len(of.commands)
            )  # fmt: skip
            told += sizes[-1]
            names = ("start", "begin", "advance", "move", "sample", "pose", "pick")
            found.append(s.Piece(
                *(self._address(f"piece{i}_{name}") for name in names), *sizes, entry, tick, self.ints(piece.places),
                self.doubles(piece.schedules), self.doubles(piece.start), command,
                (ct.c_double * 3)(*piece.first), (ct.c_double * 3)(*piece.last), (ct.c_double * 3)(*piece.turn),
            ))  # fmt: skip
        return found
