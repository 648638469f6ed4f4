"""The record of a closed loop, with which an exported controller is compared: what went in, and what came out."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import LoweredMode

from ..receding import HEADER, NUM_FIGURES, PART, Motions, MotionsTick, Plan, RecedingHorizon
from ..tracking import LowLevel

Array = NDArray[np.float64]

MAGIC = b"PIAFFE-1"
PLAN, TICK, END = 1, 2, 0
_MEASURED, _SHIFT = 11, 14  # figures that are times of the machine lie between them
_MOTION = 5  # of a plan's header
_SEGMENT, _MODE, _STAGES, _LINK, _AT = 0, 3, 4, 6, 9  # of a part's header


class Recorder:
    """A planner and a low level that record what they are given and what they return; ``run_online`` takes them.

    Args:
        mpc: the planner.
        low: the low level.
        plan_numbers: size of a plan of the exported controller.
    """

    def __init__(self, mpc: RecedingHorizon | Motions, low: LowLevel, plan_numbers: int) -> None:
        assert mpc.compiled is not None  # it has been exported
        self._mpc, self._low, self._plan_numbers, self._tick = mpc, low, plan_numbers, mpc.compiled
        self._motions = self._tick.motions if isinstance(self._tick, MotionsTick) else None
        self._planners = (self._tick.memory,) if self._motions is None else self._motions.planners
        acts = mpc.period * (1 if self._motions is None else 2) + mpc.latency
        self._stages = ceil(acts / min(each.horizon.dt for each in self._planners)) + 1
        """Stages that act or predict a state; of later ones, states and controls are recorded."""
        self.period, self.initial = mpc.period, mpc.initial
        self._parts: list[bytes] = []
        self.plans = self.ticks = 0

    # ---- planner and low level

    def reset(self) -> None:
        """Forget the last plan and the record."""
        self._mpc.reset()
        self._parts.clear()
        self.plans = self.ticks = 0

    def command(self, **values: Any) -> None:
        """Set commands."""
        self._mpc.command(**values)

    def plan(self, x: Array, t: float) -> Plan:
        """Return a plan, and record it."""
        before = self._planner()
        plan = self._mpc.plan(x, t)
        told = self._tick.commands
        memory = plan.parts.memory  # type: ignore[attr-defined]  # a tick in C has made it
        header, ranges = self._lean(memory.header, plan.modes)
        self._write(PLAN, np.array([t]), x, told, before, header)
        for first, place, count in ranges:
            self._write(place, count)
            self._parts.append(memory.numbers[first : first + count].tobytes())
        self._write(-1)
        self.plans += 1
        return plan

    def follow(self, plan: Plan) -> None:
        """Follow a plan."""
        self._low.follow(plan)

    def control(self, x: Array, t: float) -> Array:
        """Return the control of a measured state, and record it."""
        u = self._low.control(x, t)
        self._write(TICK, np.array([t]), x, u)
        self.ticks += 1
        return u

    # ---- the file

    def file(self) -> bytes:
        """Return the record as a file for ``examples/main.c``."""
        first, entries = self._planners[0].horizon.models[0], max(each.plan_entries for each in self._planners)
        sizes = (
            first.state.nx, first.control.nx, len(self._tick.commands), len(self._planner()), entries,
            self._plan_numbers, self._planners[0].width, self.plans, self.ticks,
        )  # fmt: skip
        return b"".join([MAGIC, struct.pack(f"<{len(sizes)}q", *sizes), *self._parts, struct.pack("<q", END)])

    def _write(self, *values: int | Array | NDArray[np.int64]) -> None:
        for value in values:
            self._parts.append(
                struct.pack("<q", value) if isinstance(value, int) else np.ascontiguousarray(value).tobytes()
            )

    def _planner(self) -> Array:
        """Return what a plan depends on beside the plan before; ``main.c`` has the same order."""
        m = None if self._motions is None else self._motions.c
        values = [] if m is None else [
            m.seen, m.active, m.home, m.request, m.next, m.entry, m.made, m.left, m.until
        ]  # fmt: skip
        for each in self._planners:
            c, course, clock = each.c, each.c.course, each.c.clock
            values += [
                c.has_plan, c.began, course.tick, course.place.entry, course.place.number, course.place.start,
                *course.anchor, *course.moved, *course.frame, clock.shift, clock.base, clock.flight, clock.late,
                c.last_equality, *each.memory,
            ]  # fmt: skip
        return np.array(values, dtype=float)

    def _lean(
        self, header: NDArray[np.int64], followed: Sequence[LoweredMode]
    ) -> tuple[NDArray[np.int64], list[tuple[int, int, int]]]:
        """Return the header of a plan without what no low level reads, and what is recorded of its numbers.

        The latter are ranges: where they are, where they are in the plan without the rest, and how many numbers.
        """
        own, at = header.copy(), NUM_FIGURES
        ranges = [(0, 0, _MEASURED), (_SHIFT, _SHIFT, NUM_FIGURES - _SHIFT)]
        memory = self._planners[int(header[_MOTION])]
        for i in range(int(header[0])):
            part = header[HEADER + i * PART : HEADER + (i + 1) * PART].tolist()
            mode, n = memory.modes[part[_MODE]], part[_STAGES]
            nx, ndx, nu = mode.state.nx, mode.state.ndx, mode.nu
            after = None if part[_LINK] < 0 else memory.links[part[_LINK]]
            link = 0 if after is None else after.layout.size
            stage = [len(mode.rows[f"stage_{kind}"]) for kind in "gh"]
            ends = [len(mode.rows[f"terminal_{k}"]) + (0 if after is None else len(after.rows[k])) for k in "gh"]
            rows = [n * stage[0]] * 2 + [n * stage[1]] * 2 + [ends[0]] * 2 + [ends[1]] * 2
            kept = rows if memory.c.adapt_below > 0 else [0] * len(rows)  # of an adapting barrier
            few = min(n, self._stages) if part[_SEGMENT] == 0 else 0
            read = (nu, 0, nu * ndx, nu * nu, mode.layout.size, *stage) if mode in followed else (0,) * 7
            every = nu, nu * ndx, 0, *read
            sizes = [n + 1, (n + 1) * nx, n * nu, *(n * size for size in every), link, *kept]
            counts = [n + 1, (n + 1) * nx, n * nu, *(few * size for size in every), link, *kept]
            for j, (size, count) in enumerate(zip(sizes, counts, strict=True)):
                own[HEADER + i * PART + _AT + j] = at
                if count:
                    ranges.append((part[_AT + j], at, count))
                at += (size + 7) // 8 * 8
        return own, ranges
