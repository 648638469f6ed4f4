"""The receding horizon: a problem solved again and again from measured states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import SolverError
from piaffe.ocp import SAME_TIME, Horizon, Problem, early_warnings, find_warnings

from ..ilqr import Backend, Fixed, Options, issue
from ..tracking import LowLevel
from .adapting import Adapting
from .loop import Loop, time_goes_back
from .memory import RecedingMemory
from .native_tick import NativeTick
from .numpy_tick import NumpyTick
from .plan import Plan
from .retiming import Retiming

Array = NDArray[np.float64]


class RecedingHorizon:
    """Plans a problem again and again, from measured states.

    The first plan is solved until no step helps; later ones start from the one before, shifted in time, and make a few
    iterations. A plan begins at a multiple of the first model's time step. If that is later than the time of the
    measured state, because of the latency or because the state comes off the grid, the state is predicted with the
    policy of the plan before.

    Args:
        problem: the declaration.
        period: time between plans [s], a multiple of the first model's time step.
        iterations: iterations of a plan.
        budget_s: time after which a plan's solve stops [s]; None for no limit, so that plans are deterministic.
        barrier: a barrier that plans keep, or one that adapts between plans.
        latency: time from a measured state to the first effect of its plan [s], at most the period.
        retiming: how far landings are shifted in time; None to keep the declared times.
        options: further options of the solver.
        first_iterations: iterations of the first plan, which has no limit of time.
        backend: ``"native"``: a tick is one function in C; ``"numpy"`` is the readable reference.

    Likely mistakes of the problem, and of its horizon at the motion's start, are issued as ``PiaffeWarning``;
    ``warnings`` has the same as values.

    Raises:
        SolverError: an argument is out of range.
        ProblemError: the problem does not compile, or its time steps and phases do not fit.
        NoCompilerError: the backend is native, and no compiler works.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        period: float = 0.02,
        iterations: int = 4,
        budget_s: float | None = None,
        barrier: Fixed | Adapting | None = None,
        latency: float = 0.0,
        retiming: Retiming | None = None,
        options: Options | None = None,
        first_iterations: int = 200,
        backend: Backend = "native",
    ) -> None:
        _check(iterations, first_iterations, budget_s, backend)
        early = issue(early_warnings(problem))
        self.horizon = horizon = Horizon(problem)
        self.warnings = early + issue(find_warnings(horizon.first))
        steps = round(period / horizon.dt) if np.isfinite(period) else 0
        if steps < 1 or abs(steps * horizon.dt - period) > SAME_TIME:
            raise SolverError(
                f"receding horizon: period is out of range - got {period:g} s, expected a multiple of the first "
                f"model's time step {horizon.dt:g} s; change one"
            )
        check_latency(latency, period)
        self.period, self.iterations, self.latency = period, iterations, latency
        self.first_iterations, self.backend = first_iterations, backend
        given = (barrier or Fixed(0.05, 0.1)).options(options or Options(penalty=1000.0))
        self.options = replace(given, time_limit_s=budget_s)
        adapt_below = barrier.max_defect if isinstance(barrier, Adapting) else 0.0
        self._numpy = self._native = None
        if backend == "numpy":
            self._numpy = NumpyTick(horizon, self.options, retiming, adapt_below)
        else:
            self._native = NativeTick(
                RecedingMemory(horizon, self.options, latency, iterations, first_iterations, retiming, adapt_below)
            )
        self._commands: dict[str, float] = {}
        self._last_start: float | None = None  # of a plan that was made here

    @property
    def problem(self) -> Problem:
        """The declaration."""
        return self.horizon.problem

    @property
    def initial(self) -> Array:
        """Initial state of the declared problem (nx,)."""
        return self.problem.initial

    @property
    def readable(self) -> NumpyTick:
        """The tick in NumPy; only with this backend."""
        assert self._numpy is not None  # the other backend
        return self._numpy

    @property
    def compiled(self) -> NativeTick | None:
        """The tick in C; None for the readable reference."""
        return self._native

    def reset(self) -> None:
        """Delete the last plan and all commands.

        Raises:
            SolverError: a loop makes the plans.
        """
        for tick in (self._native, self._numpy):
            if tick is not None:
                tick.reset()
        self._commands, self._last_start = {}, None
        if self._native is not None:
            self._native.tell({})

    def command(self, **values: float) -> None:
        """Set commands of the gaits, from the next plan on: ``speed``, ``lateral_speed``, ``yaw_rate``, ``height``.

        Raises:
            UnknownNameError: the motion has no such command.
            ProblemError: a value is not finite.
        """
        self._commands |= self.checked_commands(values)
        if self._native is not None:
            self._native.tell(self._commands)

    def checked_commands(self, values: Mapping[str, Any]) -> dict[str, float]:
        """Return commands as numbers.

        Raises:
            UnknownNameError: the motion has no such command.
            ProblemError: a value is not finite.
        """
        return self.horizon.checked_commands(values)

    def velocity(self, t: float) -> Array:
        """Return the commanded velocity ahead, to the left [m/s], and yaw rate [rad/s], (3,)."""
        known = self.horizon.commands | self._commands
        return np.array([known.get(name, 0.0) for name in ("speed", "lateral_speed", "yaw_rate")])

    def plan(self, x: ArrayLike, t: float) -> Plan:
        """Return a plan from a state (nx,) that was measured at time t since the motion's start [s].

        Raises:
            ProblemError: the state is not finite, or the plan would begin outside the motion.
            ShapeError: the state has another size.
            SolverError: a loop makes the plans.
        """
        state = self.horizon.checked(x)
        if not abs(t) < self.horizon.latest:  # not NaN either
            raise self.horizon.outside(t)
        last = self._last_start if self._native is None else self._native.last_start
        if last is not None and t + self.latency <= last - self.horizon.dt + SAME_TIME:
            raise time_goes_back(t, last)
        plan = self._planned(state, t)
        self._last_start = plan.start
        return plan

    def running(self, low: LowLevel, *, thread: bool = True, latency: float | None = None) -> Loop:
        """Return a loop of this receding horizon and a low level, which the caller starts.

        ``with mpc.running(low) as loop`` starts and stops it; ``loop.control(x, t)`` is the control.

        Args:
            low: the low level, made for a plan of this horizon: ``Vwbc(mpc.plan(mpc.initial, 0.0))``.
            thread: whether plans are made in a thread of their own; else within the tick, which then waits for them.
            latency: from a state to the first effect of its plan [s]; by default, and at least, that of the plans.

        Raises:
            SolverError: horizon or low level are not compiled, the low level is not for plans of this horizon, or the
                latency is zero, so that there is no time for plans in a thread, or more than the period.
        """
        if latency is not None:
            check_latency(latency, self.period)
        return Loop(self._native, low, self.period, max(self.latency, latency or 0.0), thread=thread)

    def _planned(self, state: Array, t: float) -> Plan:
        if self._native is not None:
            return self._native(state, t, self._commands)
        start = ceil((t + self.latency - SAME_TIME) / self.horizon.dt) * self.horizon.dt
        state = self.readable.predicted(state, t, start)
        iterations = self.iterations if self.readable.began else self.first_iterations
        return self.readable(state, start, t, iterations, self._commands)


def check_latency(latency: float, period: float) -> None:
    """Raise SolverError unless a latency is at most the period [s]."""
    if not 0 <= latency <= period + SAME_TIME:
        raise SolverError(
            f"receding horizon: latency is out of range - got {latency:g} s, expected 0 to the period, "
            f"{period:g} s; change one, because a planner makes one plan at a time"
        )


def _check(iterations: int, first_iterations: int, budget_s: float | None, backend: str) -> None:
    """Raise SolverError if an argument of :class:`RecedingHorizon` is out of range."""
    for name, value in (("iterations", iterations), ("first_iterations", first_iterations)):
        if not (isinstance(value, int | np.integer) and value >= 1):
            raise SolverError(
                f"receding horizon: {name} is out of range - got {value!r}, expected a whole number ≥ 1; change it"
            )
    if budget_s is not None and not 0 < budget_s < np.inf:
        raise SolverError(
            f"receding horizon: budget_s is out of range - got {budget_s} s, expected a positive number; change it"
        )
    if backend not in ("native", "numpy"):
        raise SolverError(
            f"receding horizon: backend is unknown - got {backend!r}, expected 'native' or 'numpy'; choose one"
        )
