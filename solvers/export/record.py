"""The record of a closed loop, with which an exported controller is compared: what went in, and what came out."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from math import ceil

import numpy as np
from numpy.typing import NDArray

from ..receding import HEADER, NUM_FIGURES, PART, Plan, RecedingHorizon, RecedingMemory
from ..tracking import LowLevel

Array = NDArray[np.float64]

MAGIC = b"PIAFFE-1"
PLAN, TICK, END = 1, 2, 0
_MEASURED, _SHIFT = 11, 14  # figures that are times of the machine lie between them
_SEGMENT, _MODE, _STAGES, _AT = 0, 3, 4, 9  # of a part's header


class Recorder:
    """A planner and a low level that record what they are given and what they return; ``run_online`` takes them.

    Args:
        mpc: the planner.
        low: the low level.
    """

    def __init__(self, mpc: RecedingHorizon, low: LowLevel) -> None:
        assert mpc.compiled is not None  # it has been exported
        self._mpc, self._low = mpc, low
        self._stages = ceil((mpc.period + mpc.latency) / mpc.horizon.dt) + 1
        """Stages that act or predict a state; of later ones, states and controls are recorded."""
        self._memory: RecedingMemory = mpc.compiled.memory
        self.period, self.initial = mpc.period, mpc.initial
        self._parts: list[bytes] = []
        self.plans = self.ticks = 0

    # ---- planner and low level

    def reset(self) -> None:
        """Forget the last plan and the record."""
        self._mpc.reset()
        self._parts.clear()
        self.plans = self.ticks = 0

    def command(self, **values: float) -> None:
        """Set commands."""
        self._mpc.command(**values)

    def plan(self, x: Array, t: float) -> Plan:
        """Return a plan, and record it."""
        before = self._planner()
        plan = self._mpc.plan(x, t)
        told = self._memory.tables.commands
        memory = plan.parts.memory  # type: ignore[attr-defined]  # a tick in C has made it
        self._write(PLAN, np.array([t]), x, told, before, memory.header.astype(np.int64))
        for first, last in self._recorded(memory.header):
            self._write(first, last - first)
            self._parts.append(memory.numbers[first:last].tobytes())
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
        first, memory = self._mpc.horizon.models[0], self._memory
        sizes = (
            first.state.nx, first.control.nx, len(memory.tables.commands), len(self._planner()), memory.plan_entries,
            memory.plan_numbers, memory.width, self.plans, self.ticks,
        )  # fmt: skip
        return b"".join([MAGIC, struct.pack(f"<{len(sizes)}q", *sizes), *self._parts, struct.pack("<q", END)])

    def _write(self, *values: int | Array) -> None:
        for value in values:
            self._parts.append(
                struct.pack("<q", value) if isinstance(value, int) else np.ascontiguousarray(value).tobytes()
            )

    def _planner(self) -> Array:
        """Return what a plan depends on beside the plan before; ``main.c`` has the same order."""
        c = self._memory.c
        course, clock = c.course, c.clock
        return np.array([
            c.has_plan, c.began, course.tick, course.place.entry, course.place.number, course.place.start,
            *course.anchor, *course.moved, *course.frame, clock.shift, clock.base, clock.flight, clock.late,
            *self._memory.memory,
        ], dtype=float)  # fmt: skip

    def _recorded(self, header: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
        """Yield the ranges of a plan's numbers that are recorded."""
        yield 0, _MEASURED
        yield _SHIFT, NUM_FIGURES
        memory = self._memory
        for i in range(int(header[0])):
            part = header[HEADER + i * PART : HEADER + (i + 1) * PART].tolist()
            mode, n = memory.modes[part[_MODE]], part[_STAGES]
            nx, ndx, nu = mode.state.nx, mode.state.ndx, mode.nu
            link = 0 if part[6] < 0 else memory.links[part[6]].layout.size
            few = min(n, self._stages) if part[_SEGMENT] == 0 else 0
            counts = (
                n + 1, (n + 1) * nx, n * nu, few * nu, few * nu * ndx, few * ndx, few * nu, 0, few * nu * ndx,
                few * nu * nu, few * mode.layout.size, few * len(mode.rows["stage_g"]),
                few * len(mode.rows["stage_h"]), link,
            )  # fmt: skip
            for at, count in zip(part[_AT:], counts, strict=True):
                if count:
                    yield at, at + count
