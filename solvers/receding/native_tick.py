"""A tick of the receding horizon in C."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError
from piaffe.ocp import LoweredMode, LoweredTransition

from ..ilqr import STATUS
from .memory import NOT_FINITE_PLAN, RecedingMemory
from .plan import Plan, PlannedPhase
from .plan_memory import HEADER, NUM_FIGURES, PART, PlanMemory, PlanPool

Array = NDArray[np.float64]

_ROWS = ("relaxation", "shift", "equality", "penalty", "end_relaxation", "end_shift", "end_equality", "end_penalty")
_TICKS = ("numbers", "solve", "policy")


class NativeTick:
    """Ticks in C.

    Args:
        memory: what the ticks work on.
    """

    def __init__(self, memory: RecedingMemory) -> None:
        self.memory, self.horizon, self.pool = memory, memory.horizon, PlanPool()
        self.plan: Plan | None = None
        self._in_c: tuple[PlanMemory, ...] = ()  # memory that C refers to: that of the last plan, which it reads
        self.commands = memory.code.commands
        """What C reads."""
        self.told = self.commands
        """Where :meth:`tell` writes; while a loop makes the plans, the loop's memory."""

    # ---- what a loop needs

    @property
    def modes(self) -> tuple[LoweredMode, ...]:
        """The modes that low levels follow."""
        return self.memory.code.followed

    @property
    def maker(self) -> tuple[Any, int]:
        """The function in C that makes a plan, and the address of what it works on."""
        return self.memory.code.library.receding_plan, ct.addressof(self.memory.c)

    @property
    def goes_on(self) -> bool:
        """Whether the next plan starts from the last one."""
        return bool(self.memory.c.has_plan)

    def plan_memory(self) -> PlanMemory:
        """Return memory for a plan."""
        return self.memory.plan_memory()

    def told_of(self, header: NDArray[np.int64]) -> tuple[str, str]:
        """Return the motion of a plan and the one that is asked for, by its header; empty for a planner of one."""
        return "", ""

    # ---- commands and plans

    @property
    def is_lent(self) -> bool:
        """Whether a loop makes the plans."""
        return self.told is not self.commands

    def tell(self, commands: Mapping[str, float]) -> None:
        """Set the commands of the next plan."""
        self.told[:] = self.memory.tables.commanded(commands)

    def __call__(self, x: Array, t: float, commands: Mapping[str, float]) -> Plan:
        """Return a plan from a state in the world (nx,) that was measured at time t [s].

        Raises:
            SolverError: a loop makes the plans.
        """
        self.check_free("plan(x, t)")
        self.tell(commands)
        own = self._room()
        before, self._in_c = self._in_c, (*self._in_c, own)  # before the call, after which Ctrl-C may interrupt
        if self._made(x, t, own) not in (0, NOT_FINITE_PLAN):
            self._in_c = before
            self.pool.give(own)
            raise self.horizon.outside(t)  # a state that is not finite has been refused before
        self.plan, self._in_c = self._read(own), (own,)
        return self.plan

    def _made(self, x: Array, t: float, own: PlanMemory) -> int:
        """Write a plan, and return the code of C."""
        return self.memory.plan(x, t, own)

    def _of(self, own: PlanMemory) -> RecedingMemory:
        """Return the memory of the planner that has made a plan."""
        return self.memory

    @property
    def last_start(self) -> float | None:
        """When the last plan begins [s]; None if there was none."""
        return None if self.plan is None else self.plan.start

    def check_free(self, call: str) -> None:
        """Raise SolverError if a loop makes the plans."""
        if self.is_lent:
            raise SolverError(
                f"receding horizon: a loop makes its plans - got {call}, expected begin(x, t) and control(x, t) of the "
                "loop; stop the loop first"
            )

    def copy(self, of: PlanMemory) -> Plan:
        """Return a plan with the numbers of another memory."""
        own = self._room()
        self._fill(own, of)
        return self._read(own)

    def copy_into(self, own: PlanMemory, plan: Plan) -> None:
        """Write a plan of this tick into another memory."""
        self._fill(own, memory_of(plan))

    def go_on_from(self, plan: Plan) -> None:
        """Let the next tick start from a plan of this tick."""
        own = memory_of(plan)
        self.plan, self._in_c = plan, (own,)
        self._of(own).c.last = own.c

    def reset(self) -> None:
        """Forget the last plan.

        Raises:
            SolverError: a loop makes the plans.
        """
        self.check_free("reset()")
        self.memory.reset()
        self.plan, self._in_c = None, ()

    def _room(self) -> PlanMemory:
        return self.pool.take() or self.plan_memory()

    def _fill(self, own: PlanMemory, of: PlanMemory) -> None:
        own.header[:], own.numbers[:] = of.header, of.numbers
        self._of(own).view(own)

    def _read(self, own: PlanMemory, **more: Any) -> Plan:
        header, figures = own.header, own.numbers[:NUM_FIGURES].tolist()
        of = self._of(own)
        plan = Plan(
            horizon=of.horizon, parts=_Parts(of, own), anchor=tuple(figures[0:3]),
            moved=tuple(figures[3:6]), status=STATUS[header[2]], iterations=int(header[3]), has_policy=bool(header[4]),
            cost=figures[6], max_defect=figures[7], max_equality=figures[8], max_inequality=figures[9],
            seconds=dict(zip(_TICKS, figures[11:14], strict=True)), measured_at=figures[10], shift=figures[14],
            barrier_weight=figures[15], **more,
        )  # fmt: skip
        self.pool.follow(plan.parts, own)
        return plan


class _Parts(Sequence[PlannedPhase]):
    """The phases of a plan in C memory, as views that are made on first use."""

    def __init__(self, of: RecedingMemory, memory: PlanMemory) -> None:
        self._of, self.memory = of, memory

    @property
    def address(self) -> int:
        """Where low levels in C read the plan."""
        return self.memory.address

    def __len__(self) -> int:
        return int(self.memory.header[0])

    def __getitem__(self, index: Any) -> Any:
        return self._all[index]

    @cached_property
    def _all(self) -> tuple[PlannedPhase, ...]:
        return tuple(self._part(i) for i in range(len(self)))

    def _part(self, i: int) -> PlannedPhase:
        memory, own = self._of, self.memory
        segment, number, entry, mode_number, n, _, link, flags, _, *at = (
            own.header[HEADER + i * PART : HEADER + (i + 1) * PART].tolist()
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
            own.view(first, shape) for first, shape in zip(at, shapes, strict=False)
        )
        return PlannedPhase(
            segment, number, memory.horizon.calendar.entries[entry].phase.name, mode, times, x, u, k, K, Q_x, Q_u,
            Q_xx, Q_ux, Q_uu, p, g_mask, h_mask, transition, p_transition, bool(max(flags, 0) & 1),
            self._multipliers(mode, transition, n, at[len(shapes) :]) if memory.c.adapt_below > 0 else {},
        )  # fmt: skip

    def _multipliers(
        self, mode: LoweredMode, transition: LoweredTransition | None, n: int, at: Sequence[int]
    ) -> dict[str, Array]:
        """Return the numbers of the rows of a part with n stages, as views."""
        stage = {kind: (n, len(mode.rows[f"stage_{kind}"])) for kind in "gh"}
        more = {kind: 0 if transition is None else len(transition.rows[kind]) for kind in "gh"}
        end = {kind: (len(mode.rows[f"terminal_{kind}"]) + more[kind],) for kind in "gh"}
        shapes = [shape[kind] for shape in (stage, end) for kind in "gghh"]
        return {name: self.memory.view(first, shape) for name, first, shape in zip(_ROWS, at, shapes, strict=True)}


def memory_of(plan: Plan) -> PlanMemory:
    """Return the memory of a plan that a tick in C has made."""
    assert isinstance(plan.parts, _Parts)  # a tick in C has made it
    return plan.parts.memory
