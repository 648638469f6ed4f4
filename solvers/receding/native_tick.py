"""A tick of the receding horizon in C."""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import Horizon, PlanarFrame

from ..ilqr import STATUS, Options
from .memory import HEADER, PART, RecedingMemory, Slot
from .plan import Plan, PlannedPhase

Array = NDArray[np.float64]

_TICKS = ("numbers", "solve", "policy")


class NativeTick:
    """Ticks in C. A plan's memory is used again once nothing refers to the plan.

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
        self.memory = RecedingMemory(horizon, options, latency, iterations, first_iterations)
        self._free: list[Slot] = []
        self.plan: Plan | None = None

    def __call__(self, x: Array, t: float, commands: Mapping[str, float]) -> Plan:
        """Return a plan from a state in the world (nx,) that was measured at time t [s]."""
        for piece, values in zip(self.horizon.courses.pieces, self.memory.commands, strict=True):
            if piece.functions is not None:
                declared = zip(piece.functions.commands, piece.functions.command, strict=True)
                values[:] = [commands.get(name, value) for name, value in declared]
        slot = self._free.pop() if self._free else self.memory.slot()
        code = self.memory.plan(x, t, slot)
        if code:
            self._free.append(slot)
            self.horizon.checked(x)
            raise self.horizon.outside(t)
        header, figures = slot.header, slot.numbers
        plan = Plan(
            horizon=self.horizon, parts=_Parts(self.memory, slot), anchor=_frame(figures[0:3]),
            moved=_frame(figures[3:6]), status=STATUS[header[2]], iterations=int(header[3]), has_policy=bool(header[4]),
            cost=float(figures[6]), max_defect=float(figures[7]), max_equality=float(figures[8]),
            max_inequality=float(figures[9]), seconds=dict(zip(_TICKS, figures[11:14].tolist(), strict=True)),
            measured_at=t, memory=slot,
        )  # fmt: skip
        weakref.finalize(plan, self._free.append, slot)
        self.plan = plan
        return plan

    def reset(self) -> None:
        """Forget the last plan."""
        self.plan = None
        self.memory.reset()


class _Parts(Sequence[PlannedPhase]):
    """The phases of a plan in C memory, as views that are made on first use."""

    def __init__(self, memory: RecedingMemory, slot: Slot) -> None:
        self._memory, self._slot = memory, slot

    def __len__(self) -> int:
        return int(self._slot.header[0])

    def __getitem__(self, index: Any) -> Any:
        return self._all[index]

    @cached_property
    def _all(self) -> tuple[PlannedPhase, ...]:
        return tuple(self._part(i) for i in range(len(self)))

    def _part(self, i: int) -> PlannedPhase:
        memory, slot = self._memory, self._slot
        segment, number, entry, mode_number, n, _, link, flags, _, *at = (
            slot.header[HEADER + i * PART : HEADER + (i + 1) * PART].tolist()
        )  # fmt: skip
        mode = memory.modes[mode_number]
        transition = memory.links[link] if link >= 0 else None
        nx, ndx, nu = mode.state.nx, mode.state.ndx, mode.nu
        shapes: tuple[tuple[int, ...], ...] = (
            (n + 1,), (n + 1, nx), (n, nu), (n, nu), (n, nu, ndx), (n, ndx), (n, nu), (n, ndx, ndx), (n, nu, ndx),
            (n, nu, nu), (n, mode.layout.size), (n, len(mode.rows["stage_g"])), (n, len(mode.rows["stage_h"])),
            (0 if transition is None else transition.layout.size,),
        )  # fmt: skip
        times, x, u, k, K, Q_x, Q_u, Q_xx, Q_ux, Q_uu, p, g_mask, h_mask, p_transition = (
            slot.numbers[first : first + int(np.prod(shape))].reshape(shape)
            for first, shape in zip(at, shapes, strict=True)
        )
        return PlannedPhase(
            segment, number, memory.horizon.calendar.entries[entry].phase.name, mode, times, x, u, k, K, Q_x, Q_u,
            Q_xx, Q_ux, Q_uu, p, g_mask, h_mask, transition, p_transition, bool(max(flags, 0) & 1),
        )  # fmt: skip


def _frame(values: Array) -> PlanarFrame:
    return float(values[0]), float(values[1]), float(values[2])
