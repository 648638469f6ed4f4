"""A tick of the receding horizon in Python: the readable reference of the one in C."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import CompiledProblem, Course, Horizon

from ..ilqr import Iterate, Options, ProblemFunctions, Run, sweeps_of
from ..ilqr import Sweep as Sweep
from ..solution import Status
from .plan import Plan, PlannedPhase
from .predict import after_reset
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


Solve = Callable[[CompiledProblem, Iterate, Options, list[NDArray[np.bool_]]], Solved]


class NumpyTick:
    """Ticks in Python, with a solve in NumPy.

    Args:
        horizon: the problem at any time.
        options: of the solves.
        solve: the solve of a tick; by default in NumPy.
    """

    def __init__(self, horizon: Horizon, options: Options, solve: Solve | None = None) -> None:
        self.horizon, self.options = horizon, options
        self._solve = solve or solve_in_numpy
        self.plan: Plan | None = None

    def __call__(
        self, x: Array, t: float, measured_at: float, iterations: int, commands: Mapping[str, float]
    ) -> Plan:
        """Return the plan that begins at time t [s] with a state in the world (nx,)."""
        horizon, last = self.horizon, self.plan
        began = time.perf_counter()
        course = horizon.begin(x, t, commands) if last is None else horizon.advance(last.course, x, t, commands)
        start = self._start(course, horizon.local(course, x))
        problem = horizon.at(course, start)
        numbers = time.perf_counter()
        spans = horizon.layout.at(course.tick)
        states, controls, _ = shifted(problem, spans, last, course.moved, start)
        options = replace(self.options, max_iterations=iterations)
        shooting = [np.ones(len(own), dtype=bool) for own in states]
        solved = self._solve(problem, Iterate(states, controls), options, shooting)
        parts = tuple(
            PlannedPhase(
                span.segment, span.place.number, phase, xs, us, sweep.feedforward, sweep.feedback, sweep.Q_x, sweep.Q_u,
                sweep.Q_xx, sweep.Q_ux, sweep.Q_uu,
            )
            for span, phase, xs, us, sweep in zip(
                spans, problem.phases, solved.states, solved.controls, solved.sweeps, strict=True
            )
        )  # fmt: skip
        ended = time.perf_counter()
        self.plan = Plan(
            problem, course, parts, solved.status, solved.iterations, solved.cost, solved.max_defect,
            solved.max_equality, solved.max_inequality, {"numbers": numbers - began, "solve": ended - numbers},
            measured_at,
        )  # fmt: skip
        return self.plan

    def _start(self, course: Course, x: Array) -> Array:
        """Return the state after an impact that is due now, see :meth:`Horizon.arrival`."""
        arrival = self.horizon.arrival(course)
        if arrival is None:
            return x
        return self.horizon.models[0].state.np_normalise(after_reset(*arrival, x))


def solve_in_numpy(
    problem: CompiledProblem, start: Iterate, options: Options, shooting: list[NDArray[np.bool_]]
) -> Solved:
    """Return the result of a solve by the NumPy backend from a first iterate."""
    run = Run(ProblemFunctions(problem), options, start, shooting, None)
    status = run.loop()
    at = run.current
    equality, inequality = run.violations(at)
    return Solved(
        status, at.iterate.states, at.iterate.controls, sweeps_of(run), len(run.history), at.cost, at.max_defect,
        equality, inequality,
    )  # fmt: skip
