"""A loop: a receding horizon and a low level as one controller, with plans in a thread of their own."""

from __future__ import annotations

from types import TracebackType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError, SolverError

from ..ilqr import STATUS
from ..tracking import LowLevel
from .lease import Lease
from .loop_memory import LoopMemory
from .loop_parts import ActingPlan, checked_parts
from .native_tick import NativeTick
from .plan import Plan

Array = NDArray[np.float64]

_TIME_GOES_BACK = 16  # of loop.h


class Loop:
    """A receding horizon and a low level as one controller; :meth:`RecedingHorizon.running` returns it.

    :meth:`control` is called at the rate of the low level with a measured state and its time. It hands the state to
    the planner when a plan is due, takes the newest plan from the planner once that plan begins, and returns the low
    level's control. All of this is in C, and neither thread waits for the other.

    A plan that is not complete when it should begin is missed: the plan before goes on, and the late one acts as soon
    as it is complete. No plan is asked for while the planner is busy, or from a state that is not finite; one whose
    numbers are not finite does not act. These are missed, too.

    While a loop runs it owns the receding horizon: ``plan`` and ``reset`` of that are refused, ``command`` works. The
    low level has its plan of before the start until the stop. All methods are called from one thread. A loop that is
    deleted, or left at the end of the program, is stopped.

    Args:
        planner: the tick of the receding horizon; None if it is not compiled.
        low: the low level.
        period: time between plans [s].
        latency: of plans [s].
        thread: whether plans are made in a thread of their own; else within :meth:`control`, which waits for them.
    """

    def __init__(
        self, planner: NativeTick | None, low: LowLevel, period: float, latency: float, *, thread: bool
    ) -> None:
        planner, tick = checked_parts(planner, low, period, latency, thread=thread)
        self._planner, self._low, self._tick = planner, low, tick
        self._memory = LoopMemory(planner, tick, period, latency)
        self._period, self._thread = period, thread
        self._lease: Lease | None = None

    # ---- start and stop

    @property
    def is_running(self) -> bool:
        """Whether the loop has been started and not stopped."""
        return self._lease is not None and self._lease.is_on

    def start(self) -> None:
        """Start the loop; it goes on from the last plan of the receding horizon, if there is one.

        Raises:
            SolverError: it runs already, or another loop of the same receding horizon does, or there is no thread.
        """
        self._planner.check_free("start()")
        self._lease = Lease(self._memory, self._low, self._period, thread=self._thread)

    def stop(self) -> None:
        """Stop the loop after the plan that is being made; do nothing if it does not run.

        The receding horizon goes on from its last plan, and the low level follows the plan that acted.
        """
        if self._lease is not None:
            self._lease.end()

    def __enter__(self) -> Loop:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    # ---- ticks

    def begin(self, x: ArrayLike, t: float) -> None:
        """Make a plan from a state (nx,) at time t [s] now, and follow it from now on.

        The first plan takes longer than others. Without this, the first :meth:`control` makes it.

        Raises:
            ProblemError: the state is not finite, or the plan would begin outside the motion.
            ShapeError: the state has another size.
            SolverError: the loop does not run, or the plan is not finite.
        """
        self._check_runs()
        state, before = self._planner.horizon.checked(x), self.taken
        self._memory.begin(state, t)
        self._check_fault(t)
        if self.taken == before:
            raise SolverError(
                f"loop: there is no plan from this state - got numbers that are not finite at {t:g} s, expected a "
                "plan; begin from a state nearer to the motion"
            )

    def control(self, x: ArrayLike, t: float, contacts: ArrayLike | None = None) -> Array:
        """Return the low level's control of a state (nx,) measured at time t [s], (nu,); see :class:`LowLevel`.

        Args:
            x: measured state in the world (nx,).
            t: time since the motion's start [s].
            contacts: measured contact flags (nf,), if the low level measures contacts.

        Raises:
            ProblemError: the last plan that was asked for should act now, and would begin outside the motion; or time
                goes back. The plan before goes on.
            ShapeError: the state has another size than the plan's, or there are not nf flags.
            SolverError: the loop does not run, or contacts are not given as the low level needs them.
        """
        self._check_runs()
        u = self._low.control(x, t, contacts)
        if self._memory.c.fault:
            self._check_fault(t)
        return u

    # ---- what is known

    @property
    def is_planning(self) -> bool:
        """Whether a plan is being made now."""
        return int(self._memory.c.work) != 0

    @property
    def asked(self) -> int:
        """Number of plans that were due since the start."""
        return int(self._memory.c.asked)

    @property
    def missed(self) -> int:
        """Number of plans among them that were not complete when they should have begun."""
        return int(self._memory.c.missed)

    @property
    def taken(self) -> int:
        """Number of plans that have acted since the start."""
        return int(self._memory.c.taken)

    @property
    def planning_seconds(self) -> float:
        """Time of the processor for plans that were made within the last tick [s]; 0 if a thread makes them."""
        return float(self._memory.c.within)

    @property
    def acting(self) -> ActingPlan | None:
        """What is known of the plan that acts; None before the first one since the start."""
        if not self.taken:
            return None
        c, place = self._memory.c, self._memory.c.plans.acting
        header = self._memory.places[place].header
        return ActingPlan(
            c.measured_at[place], c.seconds[place], int(header[3]), STATUS[header[2]], *self._planner.told_of(header)
        )

    @property
    def plan(self) -> Plan | None:
        """The plan that acts, as a copy that stays as it is; None before the first one since the start."""
        return self._planner.copy(self._memory.places[self._memory.c.plans.acting]) if self.taken else None

    @property
    def scheduled(self) -> Array:
        """The plan's contact flags in the last tick, (nf,); empty if the models have no such flags."""
        return self._tick.scheduled

    # ---- errors

    def _check_runs(self) -> None:
        lease = self._lease
        if lease is None or not lease.is_on:
            raise SolverError("loop: it does not run - got a call before start() or after stop(); start it first")
        if self._thread and not lease.is_here:
            raise SolverError(
                "loop: its thread is in another process - got a call after a fork, expected one in the process that "
                "started it; call stop(), then start() in this process, which begins with a new plan"
            )

    def _check_fault(self, t: float) -> None:
        code, memory = self._memory.take_fault(), self._memory
        if code == _TIME_GOES_BACK:
            raise time_goes_back(t, float(memory.c.now))
        if code:
            raise self._planner.horizon.outside(float(memory.c.asked_at))


def time_goes_back(t: float, last: float) -> ProblemError:
    """Return the error of a time before the last one."""
    return ProblemError(
        f"receding horizon: time goes back - got {t:g} s after {last:g} s, expected a later time; call reset() before "
        "another episode"
    )
