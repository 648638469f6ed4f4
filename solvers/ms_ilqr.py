"""Multi-phase multiple-shooting iLQR with augmented Lagrangian and relaxed barrier: the readable reference."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import CompiledProblem, Problem, compile_problem

from . import barrier
from .iterate import Evaluator, Iterate, PhaseDual, PhaseValues, penalty_cost, running_cost
from .options import Options
from .riccati import Direction, LqPhase, Sweep, backward, roll_out
from .status import Status

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Record:
    """One iteration, as the live table shows it and a solution keeps it."""

    iteration: int
    cost: float
    merit: float
    expected: float
    max_defect: float
    max_equality: float
    max_inequality: float
    step_size: float
    regularization: float
    barrier_weight: float
    wall_s: float


@dataclass(frozen=True, eq=False)
class Evaluated:
    """An iterate with everything that is computed from it without derivatives."""

    iterate: Iterate
    values: list[PhaseValues]
    defects: list[Array]
    cost: float

    @property
    def gap(self) -> float:
        """Sum of the absolute values of all defects: what the merit weighs."""
        return float(sum(np.sum(np.abs(d)) for d in self.defects))

    @property
    def max_defect(self) -> float:
        """Largest defect, ∞-norm in the tangent."""
        return float(max(np.max(np.abs(d), initial=0.0) for d in self.defects))


class MSiLQR:
    """Multi-phase multiple-shooting iLQR.

    Args:
        problem: a declaration, or one already compiled.
        options: tolerances and parameters.
    """

    def __init__(self, problem: Problem | CompiledProblem, options: Options | None = None) -> None:
        self.options = options or Options()
        self.problem = compile_problem(problem) if isinstance(problem, Problem) else problem
        self.evaluator = Evaluator(self.problem)

    # ---- the algorithm

    def run(self, start: Iterate, report: Callable[[Record], None] | None = None) -> Run:
        """Iterate from a start until convergence or a limit."""
        return Run(self, start, report)


class Run:
    """One solve: its current iterate, multipliers and history."""

    def __init__(self, solver: MSiLQR, start: Iterate, report: Callable[[Record], None] | None) -> None:
        self.o, self.problem, self.evaluator = solver.options, solver.problem, solver.evaluator
        self.report = report
        self.began = time.perf_counter()
        self.weight = self.o.barrier_weight
        self.duals = [self.first_dual(i) for i in range(len(self.problem.phases))]
        self.current = self.evaluate(start)
        self.history: list[Record] = []
        self.regularization = 0.0
        self.rho = 0.0
        self.sweeps: list[Sweep] = []
        self.models: list[LqPhase] = []
        self.status = Status.ITERATION_LIMIT
        self.last_equality = np.inf

    def first_dual(self, i: int) -> PhaseDual:
        """Return fresh barrier and multiplier state for a phase."""
        phase, o = self.problem.phases[i], self.o
        return PhaseDual(
            relaxation=np.full(phase.g_mask.shape, o.relaxation), end_relaxation=np.full(phase.end_g_mask.shape, o.relaxation),
            multiplier=np.zeros(phase.h_mask.shape), penalty=np.full(phase.h_mask.shape, o.penalty),
            end_multiplier=np.zeros(phase.end_h_mask.shape), end_penalty=np.full(phase.end_h_mask.shape, o.penalty),
        )  # fmt: skip

    def evaluate(self, iterate: Iterate) -> Evaluated:
        """Return an iterate's values, defects and declared cost."""
        values = self.evaluator.all_values(iterate)
        cost = sum(running_cost(p, v) for p, v in zip(self.problem.phases, values, strict=True))
        return Evaluated(iterate, values, self.evaluator.defects(iterate, values), float(cost))

    def augmented(self, at: Evaluated) -> float:
        """Return cost plus barrier plus augmented Lagrangian."""
        parts = zip(self.problem.phases, at.values, self.duals, strict=True)
        return at.cost + sum(penalty_cost(p, v, d, self.weight) for p, v, d in parts)

    def violations(self, at: Evaluated) -> tuple[float, float]:
        """Return the largest equality and inequality violations."""
        equality = inequality = 0.0
        for p, v in zip(self.problem.phases, at.values, strict=True):
            equality = max(equality, np.max(np.abs(v.h * p.h_mask), initial=0.0), np.max(np.abs(v.end_h * p.end_h_mask), initial=0.0))
            inequality = max(inequality, np.max(-v.g * p.g_mask, initial=0.0), np.max(-v.end_g * p.end_g_mask, initial=0.0))
        return float(equality), float(inequality)

    def linearise(self) -> list[LqPhase]:
        """Return the linear-quadratic model at the current iterate."""
        at = self.current
        return [
            self.evaluator.lq(i, at.iterate, at.values[i], at.defects[i], self.duals[i], self.weight)
            for i in range(len(self.problem.phases))
        ]

    def loop(self) -> Status:
        """Iterate; return how it ended."""
        o = self.o
        if not np.isfinite(self.current.cost) or not np.isfinite(self.current.gap):
            return Status.NOT_FINITE
        self.models = self.linearise()
        for iteration in range(1, o.max_iterations + 1):
            if o.time_limit_s is not None and time.perf_counter() - self.began > o.time_limit_s:
                return Status.TIME_LIMIT
            direction = self.direction()
            if direction is None:
                return Status.LINE_SEARCH_FAILED
            expected = -(direction.dV1 + 0.5 * direction.dV2)
            size = self.search(direction)
            if size > 0.0:
                self.models = self.linearise()
            self.adapt(size)
            equality, inequality = self.violations(self.current)
            record = Record(
                iteration=iteration, cost=self.current.cost, merit=self.augmented(self.current) + self.rho * self.current.gap,
                expected=expected, max_defect=self.current.max_defect, max_equality=equality, max_inequality=inequality,
                step_size=size, regularization=self.regularization, barrier_weight=self.weight,
                wall_s=time.perf_counter() - self.began,
            )  # fmt: skip
            self.history.append(record)
            if self.report:
                self.report(record)
            if self.regularization > o.max_regularization:
                return Status.LINE_SEARCH_FAILED
            if self.is_stationary(expected, size):
                if self.finish(equality, inequality):
                    return Status.CONVERGED
                self.models = self.linearise()
        return Status.ITERATION_LIMIT

    def is_stationary(self, expected: float, size: float) -> bool:
        """Return whether the sub-problem of the current barrier and multipliers is solved well enough to change them."""
        scale = 1 + abs(self.current.cost)
        tolerance = max(self.o.cost_tolerance, 0.1 * self.weight * self.o.barrier_gap) * scale
        return abs(expected) < tolerance and self.current.max_defect < self.o.max_defect

    def finish(self, equality: float, inequality: float) -> bool:
        """Return whether everything is met; otherwise move barrier and multipliers on."""
        done = equality <= self.o.max_equality and inequality <= self.o.max_inequality
        done = done and self.barrier_gap() <= self.o.barrier_gap * (1 + abs(self.current.cost))
        if not done:
            self.update_barrier()
            self.update_multipliers(equality)
        return done

    def barrier_gap(self) -> float:
        """Return the barrier's share of the cost: ε times the number of active rows and time."""
        total = 0.0
        for p, v, d in zip(self.problem.phases, self.current.values, self.duals, strict=True):
            force = -barrier.slope(v.g, d.relaxation) * v.g * p.g_mask
            near = np.where(v.g * p.g_mask > 0, force, 0.0)
            total += p.dt * float(np.sum(near * (v.g < 10 * self.o.relaxation)))
        return self.weight * total

    def update_barrier(self) -> None:
        """Shrink ε until the gap is small, and δ so that active rows hold with the multipliers they have."""
        if self.barrier_gap() > self.o.barrier_gap * (1 + abs(self.current.cost)):
            self.weight *= self.o.barrier_factor
        for v, d, p in zip(self.current.values, self.duals, self.problem.phases, strict=True):
            how = (0.25 * self.o.max_inequality, 0.7, 1e-6)
            d.relaxation = barrier.shrink(d.relaxation, v.g, p.g_mask, *how)
            d.end_relaxation = barrier.shrink(d.end_relaxation, v.end_g, p.end_g_mask, *how)

    def update_multipliers(self, equality: float) -> None:
        """Move λ by σ h; raise σ where the violation has not shrunk."""
        slow = equality > 0.25 * self.last_equality and equality > self.o.max_equality
        self.last_equality = equality
        for v, d in zip(self.current.values, self.duals, strict=True):
            d.multiplier = d.multiplier + d.penalty * v.h
            d.end_multiplier = d.end_multiplier + d.end_penalty * v.end_h
            if slow:
                d.penalty = np.minimum(d.penalty * self.o.penalty_factor, self.o.max_penalty)
                d.end_penalty = np.minimum(d.end_penalty * self.o.penalty_factor, self.o.max_penalty)

    # ---- one iteration

    def direction(self) -> Direction | None:
        """Return the step of the linear-quadratic model, regularised as far as it needs."""
        while self.regularization <= self.o.max_regularization:
            sweeps = backward(self.models, self.regularization)
            if sweeps is not None:
                self.sweeps = sweeps
                return roll_out(self.models, sweeps)
            self.raise_regularization()
        return None

    def raise_regularization(self) -> None:
        """Regularise more."""
        self.regularization = max(4 * self.regularization, self.o.regularization)

    def search(self, direction: Direction) -> float:
        """Return the step accepted by the merit line search, 0 if none; moves the current iterate."""
        o, gap = self.o, self.current.gap
        change = direction.dV1 + 0.5 * max(direction.dV2, 0.0)
        if gap > 1e-12 and change > 0:
            self.rho = max(self.rho, 1.1 * change / ((1 - o.merit_margin) * gap))
        before = self.augmented(self.current) + self.rho * gap
        size = 1.0
        while size >= o.min_step:
            trial = self.trial(direction, size)
            expected = size * direction.dV1 + 0.5 * size**2 * direction.dV2 - size * self.rho * gap
            merit = self.augmented(trial) + self.rho * trial.gap
            if np.isfinite(merit) and merit <= before + o.armijo * expected + 1e-12 * abs(before):
                self.current = trial
                return size
            size *= o.step_shrink
        return 0.0

    def trial(self, direction: Direction, size: float) -> Evaluated:
        """Return the iterate a step along the direction."""
        states, controls = [], []
        for i, phase in enumerate(self.problem.phases):
            states.append(phase.mode.state.np_plus(self.current.iterate.states[i], size * direction.dx[i]))
            controls.append(self.current.iterate.controls[i] + size * direction.du[i])
        return self.evaluate(Iterate(states, controls))

    def adapt(self, size: float) -> None:
        """Regularise less after a good step, more after a failed one."""
        if size == 0.0:
            self.raise_regularization()
            self.raise_regularization()
        elif size > 0.4:
            self.regularization = self.regularization / 4 if self.regularization > self.o.regularization else 0.0
        elif size < 0.1:
            self.raise_regularization()
