"""The memory of a receding horizon in C: tables of the motion, the solver's memory, and plans."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import SOLVER_FLAGS, aligned_zeros, build, generate, load
from piaffe.ocp import TIME_STEP, Horizon, LoweredMode, LoweredTransition

from ..ilqr import OPTIONS, TEMPLATES, Library, Options, RecordStruct, constants_header, library_of, structs_of
from . import structs as s
from .functions import generated_functions, spaces

Array = NDArray[np.float64]

_FILES = ("receding.h", "calendar.inc", "course.inc", "layout.inc", "numbers.inc", "shift.inc", "predict.inc")
HEADER, PART, NUM_FIGURES = 5, 23, 16
"""Entries of a plan's header, entries per part, and figures; as in ``receding.h``."""


@lru_cache(maxsize=8)
def _build(functions: tuple[tuple[str, Any], ...], width: int) -> tuple[ct.CDLL, Mapping[str, int]]:
    made = generate(dict(functions))
    template = files(__package__).joinpath("template")
    texts = {name: template.joinpath(name).read_text(encoding="utf-8") for name in (*_FILES, "receding.c")}
    shared = {name: TEMPLATES[name] for name in ("piaffe.h", "manifold.inc")}
    headers = {**made.headers, **shared, **{name: texts[name] for name in _FILES}, "constants.h": constants_header()}
    units = [*((unit.name, unit.text) for unit in made.units), ("receding", texts["receding.c"])]
    built = build(
        units, headers=headers, flags_per_unit={"receding": SOLVER_FLAGS}, width=width, label="receding horizon"
    )
    return load(built), made.work


class Slot:
    """The memory of one plan.

    Args:
        entries: of the header.
        numbers: number of doubles.
    """

    def __init__(self, entries: int, numbers: int) -> None:
        self.header: NDArray[np.int64] = np.zeros(entries, dtype=np.int64)
        self.numbers: Array = aligned_zeros(numbers)
        self.c = s.Plan(self.header.ctypes.data, self.numbers.ctypes.data)


class RecedingMemory:
    """The memory of a receding horizon; the constructor allocates all of it.

    Args:
        horizon: the problem at any time.
        options: of the solves.
        latency: of plans [s].
        iterations, first_iterations: of later plans and of the first.
    """

    def __init__(
        self, horizon: Horizon, options: Options, latency: float, iterations: int, first_iterations: int
    ) -> None:
        self.horizon = horizon
        self._kept: list[Any] = []
        tables = horizon.tables
        modes = tuple(store.lowered for store in tables.modes if isinstance(store.lowered, LoweredMode))
        links = tuple(store.lowered for store in tables.transitions if isinstance(store.lowered, LoweredTransition))
        self.modes, self.links = modes, links
        self.solver, _ = library_of(modes, links)
        self.width = self.solver.built.width
        functions = generated_functions(horizon)
        self.library, work = _build(tuple(functions.items()), self.width)
        self._functions = functions
        self.commands: list[Array] = []
        self._horizon = self._tables()
        self.c = s.Receding(horizon=ct.addressof(self._horizon))
        self._solver_memory(options, iterations, first_iterations)
        self.c.latency, self.c.iterations, self.c.first_iterations = latency, iterations, first_iterations
        self._work(functions, work)
        self._measure()
        self.library.receding_plan.argtypes = (ct.c_void_p, ct.c_void_p, ct.c_double, ct.c_void_p)
        self._x = np.zeros(horizon.models[0].state.nx)

    def slot(self) -> Slot:
        """Return memory for a plan."""
        return Slot(self._entries, self._numbers)

    def plan(self, x: Array, t: float, slot: Slot) -> int:
        """Write a plan from a state (nx,) at time t [s] into a slot; return the code of ``receding.h``."""
        self._x[:] = x
        return int(self.library.receding_plan(ct.addressof(self.c), self._x.ctypes.data, t, ct.addressof(slot.c)))

    def reset(self) -> None:
        """Forget the last plan."""
        self.c.has_plan = 0

    # ---- memory

    def _keep(self, thing: Any) -> Any:
        self._kept.append(thing)
        return thing

    def _doubles(self, values: Any) -> int:
        array = aligned_zeros(max(int(np.size(values)), 1))
        array[: np.size(values)] = np.ravel(np.asarray(values, dtype=float))
        return int(self._keep(array).ctypes.data)

    def _ints(self, values: Any) -> int:
        array = np.ascontiguousarray(np.ravel(np.asarray(values)), dtype=np.int32)
        return int(self._keep(array if array.size else np.zeros(1, dtype=np.int32)).ctypes.data)

    def _array(self, kind: Any, values: Sequence[Any]) -> int:
        return ct.addressof(self._keep((kind * max(len(values), 1))(*values)))

    def _address(self, name: str) -> int | None:
        if name not in self._functions:
            return None
        return ct.cast(getattr(self.library, name), ct.c_void_p).value

    # ---- tables

    def _copies(self, copies: Any) -> s.Copies:
        return s.Copies(len(copies.to), self._ints(copies.to), self._ints(copies.of))

    def _tables(self) -> s.HorizonTables:
        horizon = self.horizon
        calendar, tables = horizon.calendar, horizon.tables
        own = spaces(horizon)
        segments = []
        for i, (segment, table) in enumerate(zip(horizon.problem.schedule.segments, tables.segments, strict=True)):
            window = horizon.layout.windows[i]
            segments.append(s.Segment(
                calendar.steps[i], -1 if window is None else window, int(horizon.layout.cut[i]),
                own.index(horizon.models[i]), len(table.stage), segment.dt, self._ints(table.first),
                self._ints(table.mode), self._ints(table.stage), self._ints(table.end), self._ints(table.link),
                self._doubles(table.controls), self._copies(horizon.state_copies[i]),
            ))  # fmt: skip
        entries = [
            s.Entry(entry.placed.piece, entry.length, following, entry.start)
            for entry, following in zip(calendar.entries, calendar.following, strict=True)
        ]
        samples = np.concatenate(horizon.courses.tables)
        frames = [
            horizon.models[0].planar_frame(horizon.targets.unpack(row))
            for row in samples
        ]  # fmt: skip
        modes = [self._store(i, store, "mode") for i, store in enumerate(tables.modes)]
        links = [self._store(i, store, "transition") for i, store in enumerate(tables.transitions)]
        of_modes = [self._table(f"mode{i}_table") for i in range(len(modes))]
        of_links = [self._table(f"transition{i}_table") for i in range(len(links))]
        solver = self.solver.loaded
        return s.HorizonTables(
            tick=calendar.tick, total=-1 if np.isinf(calendar.total) else int(calendar.total),
            period=calendar.period, num_entries=len(entries), cycle=calendar.cycle,
            num_pieces=len(horizon.courses.pieces), num_segments=len(segments), num_targets=horizon.targets.size,
            num_modes=len(modes), num_transitions=len(links), entries=self._array(s.Entry, entries),
            segments=self._array(s.Segment, segments), pieces=self._array(s.Piece, self._pieces()),
            spaces=self._array(s.Space, [
                s.Space(self._address(f"space{i}_state"), self._address(f"space{i}_control"), m.state.nx, m.control.nx)
                for i, m in enumerate(own)
            ]),
            samples=self._doubles(samples), frames=self._doubles(frames),
            initial=self._doubles(np.concatenate([np.zeros(0), *map(np.ravel, horizon.targets.initial)])),
            modes=self._array(s.Store, modes), transitions=self._array(s.Store, links),
            mode_tables=self._array(ct.c_void_p, of_modes), transition_tables=self._array(ct.c_void_p, of_links),
            moved_sample=self._address("moved_sample"), pose=self._address("pose"),
            solve=ct.cast(solver.piaffe_solve, ct.c_void_p), policy=ct.cast(solver.piaffe_policy, ct.c_void_p),
        )  # fmt: skip

    def _table(self, name: str) -> int:
        return ct.addressof(ct.c_char.in_dll(self.solver.loaded, name))

    def _store(self, i: int, store: Any, kind: str) -> s.Store:
        copies = self._array(s.Copies, [self._copies(each) for each in store.copies])
        return s.Store(
            self._doubles(store.rows), copies, self._address(f"{kind}{i}_weights"),
            self._address(f"{kind}{i}_end_weights"), store.lowered.layout.slices[TIME_STEP].start,
        )  # fmt: skip

    def _pieces(self) -> list[s.Piece]:
        found = []
        for i, (piece, (entry, tick)) in enumerate(
            zip(self.horizon.courses.pieces, self.horizon.calendar.firsts, strict=True)
        ):
            of = piece.functions
            command = np.zeros(0) if of is None else np.array(of.command, dtype=float)
            self.commands.append(self._keep(command))
            sizes = (0,) * 5 if of is None else (
                of.num_memory, of.num_sample, of.num_schedule, of.num_start, len(of.commands)
            )  # fmt: skip
            names = ("start", "begin", "advance", "move", "sample", "pose", "pick")
            found.append(s.Piece(
                *(self._address(f"piece{i}_{name}") for name in names), *sizes, entry, tick, self._ints(piece.places),
                self._doubles(piece.schedules), self._doubles(piece.start), command.ctypes.data,
                (ct.c_double * 3)(*piece.first), (ct.c_double * 3)(*piece.last), (ct.c_double * 3)(*piece.turn),
            ))  # fmt: skip
        return found

    # ---- the solver

    def _solver_memory(self, options: Options, iterations: int, first_iterations: int) -> None:
        c, kinds = self.c, structs_of(self.width)
        for name in OPTIONS:
            value = getattr(options, name)
            setattr(c.options, name, 0.0 if value is None else value)
        problem = self._keep(kinds.Problem())
        self._initial = aligned_zeros(self.horizon.models[0].state.nx)
        problem.initial = self._initial.ctypes.data
        self._history = self._keep((RecordStruct * max(iterations, first_iterations))())
        problem.history = ct.cast(self._history, type(problem.history))
        every: list[LoweredMode | LoweredTransition] = [*self.modes, *self.links]
        most = max([1, *(sum(len(rows) for rows in each.rows.values()) for each in every)])
        problem.slope, problem.curvature = (self._doubles(np.zeros(most * self.width)) for _ in range(2))
        self.problem = problem
        c.problem = ct.addressof(problem)
        scratch = self._keep((kinds.Block * len(every))())
        for i, (block, lowered) in enumerate(zip(scratch, every, strict=True)):
            rows = {kind: len(own) for kind, own in lowered.rows.items()}
            name = f"mode{i}" if i < len(self.modes) else f"transition{i - len(self.modes)}"
            factors = _factors(self.solver, name)
            counts = {
                "p": lowered.layout.size, "z": lowered.nz, "factors": factors,
                "residual": rows.get("stage_residual", rows.get("residual", 0)),
                "g": rows.get("stage_g", rows.get("g", 0)), "h": rows.get("stage_h", rows.get("h", 0)),
            }  # fmt: skip
            for key, count in {**counts, "weight": counts["residual"]}.items():
                setattr(block, key, self._doubles(np.zeros(max(count, 1) * self.width)))
            block.count = 1
        c.scratch = ct.addressof(scratch)

    def _work(self, functions: Mapping[str, Any], work: Mapping[str, int]) -> None:
        c, horizon = self.c, self.horizon
        pieces = [piece.functions for piece in horizon.courses.pieces if piece.functions is not None]
        c.most_memory = max([1, *(of.num_memory for of in pieces)])
        self._memory = aligned_zeros(c.most_memory)
        c.course.memory = self._memory.ctypes.data
        count = len(horizon.courses.pieces)
        c.frames, c.memories = self._doubles(np.zeros(3 * count)), self._doubles(np.zeros(count * c.most_memory))
        nows = self._keep(np.zeros(count, dtype=np.int64))
        c.nows = nows.ctypes.data
        most = max(
            sum(f.numel_in(i) for i in range(f.n_in())) + sum(f.numel_out(i) for i in range(f.n_out()))
            for f in functions.values()
        )
        c.lanes = self._doubles(np.zeros(most * self.width))
        c.work = self._doubles(np.zeros(max(1, *work.values()) * self.width))
        lowered: list[LoweredMode | LoweredTransition] = [*self.modes, *self.links]
        largest = max(each.layout.size for each in lowered)
        own = [of.num_sample + of.num_start for of in pieces]
        c.rows = self._doubles(np.zeros(max([largest, *own])))
        widest = max(model.state.nx for model in horizon.models)
        c.x, c.x_next = self._doubles(np.zeros(widest)), self._doubles(np.zeros(widest))

    def _measure(self) -> None:
        """Allocate for the longest horizon."""
        c, horizon, calendar = self.c, self.horizon, self.horizon.calendar
        step = calendar.steps[0]
        last = sum(entry.length for entry in calendar.entries)
        starts = range(0, last - step + 1, step)
        size, numbers, entries = ct.c_size_t(), ct.c_long(), ct.c_long()
        phases, nodes = ct.c_int(), ct.c_int()
        stages = sum(
            int(last if window is None else window) // each
            for window, each in zip(horizon.layout.windows, calendar.steps, strict=True)
        )
        spans = self._keep((s.Span * (stages + 1))())
        c.spans = ct.addressof(spans)

        def at(k: int) -> None:
            self.library.receding_sizes(
                ct.byref(c), ct.c_long(k), ct.byref(size), ct.byref(numbers), ct.byref(entries), ct.byref(phases),
                ct.byref(nodes),
            )  # fmt: skip

        most_nodes = 0
        for k in starts:
            at(k)
            most_nodes = max(most_nodes, nodes.value)
            c.max_phases = max(c.max_phases, phases.value)
        c.max_nodes = most_nodes
        c.nodes = ct.addressof(self._keep((s.Node * most_nodes)()))
        c.samples = self._doubles(np.zeros(most_nodes * max(horizon.targets.size, 1)))
        bytes_needed = self._numbers = self._entries = 0
        for k in starts:
            at(k)
            bytes_needed = max(bytes_needed, size.value)
            self._numbers, self._entries = max(self._numbers, numbers.value), max(self._entries, entries.value)
        self._arena = aligned_zeros(bytes_needed // 8 + 64)
        c.arena.base, c.arena.size = self._arena.ctypes.data, self._arena.nbytes


def _factors(library: Library, name: str) -> int:
    """Return the number of factors of a mode or transition, from the sizes at the beginning of its table."""
    sizes = (ct.c_int * 6).in_dll(library.loaded, f"{name}_table")
    return int(sizes[4] if name.startswith("mode") else sizes[5])
