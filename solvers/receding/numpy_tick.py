"""A tick of the receding horizon in Python: the readable reference of the one in C."""

from __future__ import annotations

import time
from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError
from piaffe.ocp import ORIGIN, SAME_TIME, CompiledProblem, Course, Horizon, composed, is_same_time, relative

from ..ilqr import Iterate, Options, Outer, ProblemFunctions, Run, Sweep, adapt_for_next, move, sweeps_of
from ..solution import Status
from .plan import Plan, PlannedPhase
from .predict import after_reset, predicted
from .retiming import Clock, Retiming
from .rows import keep_rows
from .shift import shifted

Array = NDArray[np.float64]


class Solved(NamedTuple):
    """The result of the solve of a tick."""

    status: Status
    states: list[Array]
    controls: list[Array]
    sweeps: list[Sweep]
    iterations: int
    cost: float
    max_defect: float
    max_equality: float
    max_inequality: float


class NumpyTick:
    """Ticks in Python and NumPy.

    Args:
        horizon: the problem at any time.
        options: of the solves.
        retiming: of landings; None for none.
        adapt_below: see :class:`Adapting`; 0 for a fixed barrier.
    """

    def __init__(
        self, horizon: Horizon, options: Options, retiming: Retiming | None = None, adapt_below: float = 0.0
    ) -> None:
        self.horizon, self.options, self.adapt_below = horizon, options, adapt_below
        self.clock = Clock(horizon, retiming)
        self.plan: Plan | None = None
        """The last plan; None if there was none, or if it is not finite, so that the next one begins anew."""
        self.course: Course | None = None
        self.outer: Outer | None = None
        """Barrier, multipliers and penalties after the last plan."""
        self.began = False

    def predicted(self, x: Array, t: float, start: float) -> Array:
        """Return the state (nx,) at a later time [s] under the last plan, in the world like the state measured at t.

        A state that is not finite then is far from the plan: this one is forgotten, and the state is held.
        """
        state = self.later(x, t, start)
        if state is None:
            self.plan = self.course = None
            return x
        return state

    def later(self, x: Array, t: float, until: float) -> Array | None:
        """Return the state (nx,) at a later time [s] under the last plan, as :meth:`predicted`; None if not finite."""
        last, course = self.plan, self.course
        if last is None or course is None or until <= t + SAME_TIME:
            return x
        tick, state = self.horizon.calendar.tick, last.local(x)
        k = round(t / tick) - self.clock.shift
        if k >= course.tick and is_same_time((k + self.clock.shift) * tick, t):
            state = self._arrived(course, state, k)
        state = last.world(predicted(last, state, t, until))
        return state if np.isfinite(state).all() else None

    def __call__(
        self,
        x: Array,
        t: float,
        measured_at: float,
        iterations: int,
        commands: Mapping[str, float],
        anew: bool = False,
    ) -> Plan:
        """Return the plan that begins at time t [s] with a state in the world (nx,).

        Args:
            x: the state.
            t: the time.
            measured_at: time of the measured state [s].
            iterations: of the solve.
            commands: commanded values that differ from the declared ones.
            anew: whether the motion begins at the robot, and the last plan is but a guess.
        """
        horizon, last = self.horizon, self.plan
        began = time.perf_counter()
        before, earlier = self.course, copy(self.clock)
        begin = round(t / horizon.dt) * horizon.calendar.steps[0]
        self.clock.retime(x, begin, None if before is None else before.tick, None if anew else before)
        shift, same = self.clock.seconds, self.clock.shift == earlier.shift
        t -= shift
        try:
            if before is None or anew:
                course = horizon.begin(x, t, commands)
            else:
                course = horizon.advance(before, x, t, commands)
        except ProblemError:
            self.clock = earlier  # no plan, so its state has not moved the clock
            raise
        if before is not None and anew:
            course = replace(course, moved=composed(relative(ORIGIN, course.anchor), before.anchor))
        start = self._arrived(course, horizon.local(course, x), course.tick)
        problem = horizon.at(course, start)
        numbers = time.perf_counter()
        spans = horizon.layout.at(course.tick)
        clock = None if same else shift
        states, controls, fresh = shifted(problem, spans, last, course.moved, start, clock)
        options = replace(self.options, max_iterations=iterations)
        if not self.began:
            options = replace(options, time_limit_s=None)  # the first plan has no limit of time
        lands = [False, *(phase.lands for phase in problem.phases[:-1])]
        shooting = [
            np.full(len(own), not (last is not None and new and landed))
            for own, new, landed in zip(states, fresh, lands, strict=True)
        ]
        outer = Outer(problem, options)
        if self.adapt_below > 0 and last is not None and self.outer is not None:
            outer.weight, outer.last_equality = self.outer.weight, self.outer.last_equality
            keep_rows(problem, spans, last, outer.duals, clock)
        solved = solve_in_numpy(problem, Iterate(states, controls), options, shooting, outer, self.adapt_below)
        self.outer = outer
        parts = tuple(
            PlannedPhase(
                segment=span.segment, number=span.place.number, name=phase.name, mode=phase.mode,
                times=phase.times + shift, states=xs, controls=us, feedforward=sweep.feedforward,
                feedback=sweep.feedback, Q_x=sweep.Q_x, Q_u=sweep.Q_u, Q_xx=sweep.Q_xx, Q_ux=sweep.Q_ux,
                Q_uu=sweep.Q_uu, p=phase.p, g_mask=phase.g_mask, h_mask=phase.h_mask, transition=phase.transition,
                p_transition=phase.p_transition, resets=phase.resets,
                multipliers=dual.stored() if self.adapt_below > 0 else {},
            )
            for span, phase, xs, us, sweep, dual in zip(
                spans, problem.phases, solved.states, solved.controls, solved.sweeps, outer.duals, strict=True
            )
        )  # fmt: skip
        ended = time.perf_counter()
        plan = Plan(
            horizon, parts, course.anchor, course.moved, solved.status, solved.iterations,
            any(bool(sweep.Q_uu.any()) for sweep in solved.sweeps), solved.cost, solved.max_defect,
            solved.max_equality, solved.max_inequality, {"numbers": numbers - began, "solve": ended - numbers},
            measured_at, shift, outer.weight,
        )  # fmt: skip
        self.plan, self.course = (plan, course) if _is_finite(plan) else (None, None)
        self.began = True
        return plan

    def reset(self) -> None:
        """Forget the last plan."""
        self.plan = self.course = self.outer = None
        self.began = False
        self.clock.reset()

    def _arrived(self, course: Course, x: Array, k: int) -> Array:
        """Return the state after an impact that is due at tick k, see :meth:`Horizon.arrival`."""
        arrival = self.horizon.arrival(course, k)
        if arrival is None:
            return x
        return self.horizon.models[0].state.np_normalise(after_reset(*arrival, x))


def _is_finite(plan: Plan) -> bool:
    """Return whether cost, defects, states, controls and gains of a plan are finite."""
    arrays = [a for part in plan.parts for a in (part.states, part.controls, part.feedforward, part.feedback)]
    return bool(np.isfinite(plan.cost + plan.max_defect)) and all(np.isfinite(array).all() for array in arrays)


def solve_in_numpy(
    problem: CompiledProblem,
    start: Iterate,
    options: Options,
    shooting: list[NDArray[np.bool_]],
    outer: Outer,
    adapt_below: float,
) -> Solved:
    """Return the result of a solve by the NumPy backend from a first iterate.

    Args:
        problem: the problem.
        start: the first iterate.
        options: of the solve.
        shooting: which nodes are shooting nodes.
        outer: barrier, multipliers and penalties of the solve; after it those of the next one.
        adapt_below: see :class:`Adapting`; 0 if they stay as they are.
    """
    functions = ProblemFunctions(problem)
    if not all(flags.all() for flags in shooting):
        still = [np.zeros((phase.num_stages + 1, phase.mode.state.ndx)) for phase in problem.phases]
        start = move(functions, start, still, [np.zeros_like(u) for u in start.controls], 0.0, shooting)
    run = Run(functions, options, start, shooting, None)
    run.outer = outer
    status = run.loop()
    at, sweeps = run.current, sweeps_of(run)
    equality, inequality = run.violations(at)
    if adapt_below > 0:
        adapt_for_next(run, status, adapt_below)
    return Solved(
        status, at.iterate.states, at.iterate.controls, sweeps, len(run.history), at.cost, at.max_defect, equality,
        inequality,
    )  # fmt: skip
