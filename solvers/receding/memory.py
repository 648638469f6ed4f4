"""The memory of a receding horizon in C: what a tick works on, and plans."""

from __future__ import annotations

import ctypes as ct
from math import gcd

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import aligned_zeros
from piaffe.ocp import Horizon, LoweredMode, LoweredTransition

from ..ilqr import OPTIONS, Options, structs_of
from . import structs as s
from .code import HorizonCode
from .keeper import Keeper
from .plan_memory import HEADER, PART, PlanMemory
from .retiming import Retiming
from .tables import HorizonMemory

Array = NDArray[np.float64]

OUTSIDE, NOT_FINITE_STATE, NOT_FINITE_PLAN = 1, 2, 3
"""What ``receding_plan`` returns instead of 0; with the last there is a plan, which the next one does not use."""


class RecedingMemory(Keeper):
    """The memory of a receding horizon; the constructor allocates all of it but that of plans.

    Args:
        horizon: the problem at any time.
        options: of the solves.
        latency: of plans [s]. retiming: of landings; None for none.
        iterations: of a plan.
        first_iterations: of the first plan.
        adapt_below: see :class:`Adapting`; 0 for a fixed barrier.
        code: the libraries; by default those of this horizon alone.
        number: of the horizon among those of the code.

    Attributes:
        starts: ticks at which a horizon may begin; later ones of a cycle need no more memory.
        num_spans: most stages of a horizon.
        arena_bytes: of the solver's memory.
        plan_numbers: doubles of a plan. plan_entries: of its header.
        c: the structure.
    """

    def __init__(
        self,
        horizon: Horizon,
        options: Options,
        latency: float,
        iterations: int,
        first_iterations: int,
        retiming: Retiming | None = None,
        adapt_below: float = 0.0,
        code: HorizonCode | None = None,
        number: int = 0,
    ) -> None:
        super().__init__()
        self.code = code = code or HorizonCode([horizon])
        self.horizon, self.tables = horizon, HorizonMemory(horizon, code, number)
        self.modes, self.links, self.width = self.tables.modes, self.tables.links, code.width
        self.c = s.Receding(
            horizon=ct.addressof(self.tables.c), latency=latency, iterations=iterations,
            first_iterations=first_iterations, adapt_below=adapt_below,
        )  # fmt: skip
        if retiming is not None:
            self.c.clock.limit, self.c.clock.gain = retiming.limit, retiming.gain
        self.c.clock.flight = -1
        self._solver_memory(options)
        self._work()
        self.measure()
        self._plan = code.library.receding_plan
        self._plan.argtypes = (ct.c_void_p, ct.c_void_p, ct.c_double, ct.c_void_p)
        self._x = np.zeros(horizon.models[0].state.nx)

    def plan_memory(self) -> PlanMemory:
        """Return memory for a plan."""
        return PlanMemory(self.plan_entries, self.plan_numbers)

    def plan(self, x: Array, t: float, plan: PlanMemory) -> int:
        """Write a plan from a state (nx,) at time t [s]; return the code of ``receding.h``."""
        self._x[:] = x
        return int(self._plan(ct.addressof(self.c), self._x.ctypes.data, t, ct.addressof(plan.c)))

    def view(self, plan: PlanMemory) -> None:
        """Let the view of a plan refer to its numbers."""
        self.code.library.receding_view(ct.byref(self.tables.c), ct.byref(plan.c))

    def reset(self) -> None:
        """Forget the last plan."""
        self.c.has_plan = self.c.began = 0
        clock = self.c.clock
        clock.shift, clock.base, clock.flight, clock.late = 0, 0, -1, 0.0

    def _solver_memory(self, options: Options) -> None:
        c, kinds = self.c, structs_of(self.width)
        for name in OPTIONS:
            setattr(c.options, name, options.number(name))
        problem = self.keep(kinds.Problem())
        self._initial = aligned_zeros(self.horizon.models[0].state.nx)
        problem.initial = self._initial.ctypes.data
        every: list[LoweredMode | LoweredTransition] = [*self.modes, *self.links]
        most = max([1, *(sum(len(rows) for rows in each.rows.values()) for each in every)])
        problem.slope, problem.curvature = (self.zero_vectors(most, self.width) for _ in range(2))
        self.problem = problem
        c.problem = ct.addressof(problem)

    def _work(self) -> None:
        """Allocate what functions read and write."""
        c = self.c
        pieces = self.horizon.courses.pieces
        own = [piece.functions for piece in pieces if piece.functions is not None]
        c.most_memory = max([1, *(of.num_memory for of in own)])
        self.memory = self.keep(aligned_zeros(c.most_memory))
        c.course.memory = self.memory.ctypes.data
        c.frames, c.memories = self.zeros(3 * len(pieces)), self.zeros(len(pieces) * c.most_memory)
        c.nows = self.keep(np.zeros(len(pieces), dtype=np.int64)).ctypes.data
        ends = max((of.num_sample for of in own), default=0) + max((of.num_start for of in own), default=0)
        layouts = [mode.layout for mode in self.modes] + [link.layout for link in self.links]
        c.rows = self.zeros(max(ends, *(layout.size for layout in layouts)))
        c.x = self.zeros(self.horizon.models[0].state.nx)

    def be_lean(self) -> None:
        """Leave out of plans what no low level reads; plans that Python reads need it."""
        self.tables.c.lean = 1
        self.measure()

    def measure(self) -> None:
        """Allocate for the longest horizon: every start up to the end of the calendar's entries tells its needs.

        A cycle need not be a whole number of steps of the first model. Later cycles then begin at other ticks.
        """
        c, horizon, calendar = self.c, self.horizon, self.horizon.calendar
        step, last = calendar.steps[0], sum(entry.length for entry in calendar.entries)
        most = sum(
            int(last if window is None else window) // each
            for window, each in zip(horizon.layout.windows, calendar.steps, strict=True)
        )  # stages; a part has at least one, one node more than stages, and perhaps a middle for each
        self.num_spans = most
        spans, nodes, firsts = (s.Span * most)(), (s.Node * (3 * most))(), (ct.c_int * most)()
        c.spans, c.nodes, c.firsts = (ct.addressof(each) for each in (spans, nodes, firsts))  # to measure
        size, numbers, entries = ct.c_size_t(), ct.c_long(), ct.c_long()
        needs = []
        end = last if calendar.cycle else last - step + 1
        self.starts = range(0, end, gcd(step, calendar.period))
        for k in self.starts:
            self.code.library.receding_sizes(
                ct.byref(c), ct.c_long(k), ct.byref(size), ct.byref(numbers), ct.byref(entries)
            )
            needs.append((size.value, numbers.value, entries.value, c.num_nodes))
        self.arena_bytes, self.plan_numbers, self.plan_entries, num_nodes = (
            max(each) for each in zip(*needs, strict=True)
        )
        num_parts = (self.plan_entries - HEADER) // PART
        c.spans, c.nodes = self.array(s.Span, [s.Span()] * num_parts), self.array(s.Node, [s.Node()] * num_nodes)
        c.firsts, c.samples = self.ints(np.zeros(num_parts)), self.zeros(num_nodes * horizon.targets.size)
        self.work_in(aligned_zeros(self.arena_bytes // 8 + 8))

    def work_in(self, arena: Array) -> None:
        """Let the solver work in other memory, of ``arena_bytes`` or more; nothing there is kept after a tick."""
        self._arena, self.c.arena.base = arena, arena.ctypes.data
