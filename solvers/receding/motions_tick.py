"""Plans of several motions in C: the planners, and what decides between them."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import aligned_zeros

from . import structs as s
from .changes import Changes
from .keeper import Keeper
from .memory import RecedingMemory
from .native_tick import NativeTick, memory_of
from .plan import Plan
from .plan_memory import PlanMemory

Array = NDArray[np.float64]

_MOTION, _REQUEST = 5, 6  # of a plan's header


class MotionsMemory(Keeper):
    """The memory of several motions in C, ``Motions`` of ``template/motions.h``.

    Args:
        planners: the planners, which share their code.
        changes: where one motion gives way to another.
        after: per motion, the one that follows its end; -1 for the last one without an end.
        home: the motion that counts as the last one without an end before the first plan.
        preparations: plans that are made ahead of a change, at least.
        period: between plans [s].

    Attributes:
        code: the libraries. c: the structure.
    """

    def __init__(
        self,
        planners: Sequence[RecedingMemory],
        changes: Changes,
        after: Sequence[int],
        home: int,
        preparations: int,
        period: float,
    ) -> None:
        super().__init__()
        self.planners, self.code = tuple(planners), planners[0].code
        motions = [
            s.Motion(ct.addressof(planner.c), following, self.ints(entries))
            for planner, following, entries in zip(planners, after, changes.entries, strict=True)
        ]
        self.share()
        self.ahead = self.plan_memory()
        self.c = s.Motions(
            motions=self.array(s.Motion, motions), num=len(motions), preparations=preparations, period=period,
            wanted=self.code.commands.ctypes.data, ahead=self.ahead.c, home=home,
        )  # fmt: skip
        self.address = ct.addressof(self.c)
        self._plan = self.code.library.motions_plan
        self._plan.argtypes = (ct.c_void_p, ct.c_void_p, ct.c_double, ct.c_void_p)
        self._reset = self.code.library.motions_reset
        self._reset.argtypes, self._reset.restype = (ct.c_void_p, ct.c_int), None
        self._x = np.zeros(planners[0].horizon.models[0].state.nx)

    def share(self) -> None:
        """Let all planners, which work in turn, work in the same memory."""
        arena = aligned_zeros(max(each.arena_bytes for each in self.planners) // 8 + 8)
        for each in self.planners:
            each.work_in(arena)

    def plan_memory(self) -> PlanMemory:
        """Return memory for a plan of any motion."""
        return PlanMemory(
            max(each.plan_entries for each in self.planners), max(each.plan_numbers for each in self.planners)
        )

    def plan(self, x: Array, t: float, plan: PlanMemory) -> int:
        """Write a plan from a state (nx,) at time t [s]; return the code of ``receding.h``."""
        self._x[:] = x
        return int(self._plan(self.address, self._x.ctypes.data, t, ct.addressof(plan.c)))

    def reset(self, first: int) -> None:
        """Forget all plans and the request; a motion is active."""
        self._reset(self.address, first)


class MotionsTick(NativeTick):
    """Plans of several motions in C.

    Args:
        memory: what the ticks work on.
        names: of the motions.
        start: index of the first motion.
    """

    def __init__(self, memory: MotionsMemory, names: Sequence[str], start: int) -> None:
        super().__init__(memory.planners[start])
        self.motions, self.names, self._start = memory, tuple(names), start
        self._before: Plan | None = None
        self._requests = 0
        self.reset()

    # ---- what a loop needs

    @property
    def maker(self) -> tuple[Any, int]:
        """The function in C that makes a plan, and the address of what it works on."""
        return self.motions.code.library.motions_plan, self.motions.address

    @property
    def goes_on(self) -> bool:
        """Whether the next plan starts from the last one."""
        return bool(self.motions.planners[self.active].c.has_plan)

    def plan_memory(self) -> PlanMemory:
        """Return memory for a plan."""
        return self.motions.plan_memory()

    def told_of(self, header: NDArray[np.int64]) -> tuple[str, str]:
        """Return the motion of a plan and the one that is asked for, by its header; empty for none."""
        motion, request = int(header[_MOTION]), int(header[_REQUEST])
        return self.names[motion], "" if motion == request else self.names[request]

    # ---- commands and plans

    @property
    def active(self) -> int:
        """Index of the motion that plans."""
        return int(self.motions.c.active)

    def ask_for(self, motion: int) -> None:
        """Ask for a motion, from the next plan on."""
        self._requests += 1
        self.told[0] = motion + len(self.names) * self._requests

    def tell(self, commands: Mapping[str, float]) -> None:
        """Set the commands of the next plan."""
        for planner, first in zip(self.motions.planners, self.motions.code.firsts, strict=True):
            values = planner.tables.commanded(commands)
            self.told[first : first + len(values)] = values

    def __call__(self, x: Array, t: float, commands: Mapping[str, float]) -> Plan:
        """Return a plan from a state in the world (nx,) that was measured at time t [s].

        Raises:
            SolverError: a loop makes the plans.
        """
        before = self.plan
        plan = super().__call__(x, t, commands)
        self._before = before  # the plan of the motion before acts until a change, and predicts the state until then
        if before is not None:
            self._in_c = (memory_of(before), *self._in_c)
        return plan

    def go_on_from(self, plan: Plan) -> None:
        """Let the next tick start from a plan of this tick."""
        super().go_on_from(plan)
        self._before, self.motions.c.left = None, -1

    def reset(self) -> None:
        """Forget all plans and the request.

        Raises:
            SolverError: a loop makes the plans.
        """
        self.check_free("reset()")
        self.told[0] = float(self._start)
        self._requests = 0
        self.motions.reset(self._start)
        self.plan, self._before, self._in_c = None, None, ()

    def _made(self, x: Array, t: float, own: PlanMemory) -> int:
        return self.motions.plan(x, t, own)

    def _of(self, own: PlanMemory) -> RecedingMemory:
        return self.motions.planners[int(own.header[_MOTION])]

    def _read(self, own: PlanMemory, **more: Any) -> Plan:
        motion, request = self.told_of(own.header)
        return super()._read(own, motion=motion, request=request, every_mode=self.modes, **more)
