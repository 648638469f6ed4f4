"""When plans are made: at once, or in a thread of their own while the robot moves."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor, Future
from time import thread_time
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .command import Command
from .planner import LoopLike, Planner

Array = NDArray[np.float64]


class MadePlan(NamedTuple):
    """A plan.

    Attributes:
        plan: the plan.
        time: at which its state was measured [s].
        seconds: time of the thread's processor that it took [s].
    """

    plan: Any
    time: float
    seconds: float


class Planning(Protocol):
    """Who makes the plans."""

    def ask(self, x: Array, t: float, commands: Sequence[Command]) -> bool:
        """Ask for a plan from a state (nx,) measured at time t [s]; return False if the planner is still busy.

        Args:
            x: the state.
            t: the time.
            commands: what the planner is told first.
        """
        ...

    def take(self) -> MadePlan | None:
        """Return the plan that was asked for; None if it is not ready."""
        ...


class PlanningAtOnce:
    """Makes a plan when it is taken; simulated time waits for it.

    Args:
        planner: the planner.
    """

    def __init__(self, planner: Planner) -> None:
        self._planner = planner
        self._asked: tuple[Array, float, Sequence[Command]] | None = None

    def ask(self, x: Array, t: float, commands: Sequence[Command]) -> bool:
        """Note a state."""
        self._asked = x, t, commands
        return True

    def take(self) -> MadePlan | None:
        """Make the plan of the last state."""
        asked, self._asked = self._asked, None
        return None if asked is None else made(self._planner, *asked)


class PlanningInThread:
    """Makes plans in a thread, one at a time.

    A plan that is not ready when it is due is missed. While it is made, no other begins; if it is ready when the next
    one is due, it acts in its place. The first plan is made at once.

    Args:
        planner: the planner.
        executor: has the thread.
    """

    def __init__(self, planner: Planner, executor: Executor) -> None:
        self._planner, self._executor = planner, executor
        self._future: Future[MadePlan] | None = None
        self._first: MadePlan | None = None
        self._started, self._begun = False, True
        self.asked = self.missed = 0

    def ask(self, x: Array, t: float, commands: Sequence[Command]) -> bool:
        """Begin a plan, unless the one before is not finished; this one is then missed."""
        self.asked += 1
        if not self._started:
            self._first, self._started = made(self._planner, x, t, commands), True
            return True
        self._begun = self._future is None or self._future.done()
        if not self._begun:
            return False
        self._future = self._executor.submit(made, self._planner, x, t, commands)
        return True

    def take(self) -> MadePlan | None:
        """Return the plan if it is ready, and count it as missed if not.

        Raises:
            Exception: what the planner raised.
        """
        if self._first is not None:
            first, self._first = self._first, None
            return first
        ready = self._future is not None and self._future.done()
        self.missed += not (ready and self._begun)
        if self._future is None or not ready:
            return None
        plan, self._future = self._future.result(), None
        return plan


class PlanningInLoop:
    """Plans that a loop makes by itself.

    Args:
        planner: takes the commands.
        loop: makes the plans and the ticks. It runs.
    """

    def __init__(self, planner: Planner, loop: LoopLike) -> None:
        self._planner, self.loop = planner, loop
        self._taken = 0

    def ask(self, x: Array, t: float, commands: Sequence[Command]) -> bool:
        """Pass commands on; the loop itself asks for plans, at its ticks. The first plan is made here."""
        tell(self._planner, commands)
        if not self.loop.taken:
            self.loop.begin(x, t)
        return True

    def take(self) -> MadePlan | None:
        """Return what is known of the plan that acts, if it is a new one."""
        if self.loop.taken == self._taken:
            return None
        self._taken, acting = self.loop.taken, self.loop.acting
        return MadePlan(acting, acting.measured_at, acting.seconds)

    @property
    def asked(self) -> int:
        """Number of plans that were due, the first included."""
        return self.loop.asked + 1

    @property
    def missed(self) -> int:
        """Number of plans that were late or not made."""
        return self.loop.missed


def tell(planner: Any, commands: Sequence[Command]) -> None:
    """Tell a planner its commands; run_online has checked that it takes them."""
    for command in commands:
        planner.command(**command.values)


def made(planner: Planner, x: Array, t: float, commands: Sequence[Command]) -> MadePlan:
    """Tell a planner its commands, and return its plan."""
    tell(planner, commands)
    begin = thread_time()
    plan = planner.plan(x, t)
    return MadePlan(plan, t, thread_time() - begin)
