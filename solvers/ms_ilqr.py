"""Multi-phase multiple-shooting iLQR with augmented Lagrangian and relaxed barrier: the readable reference."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError
from piaffe.ocp import CompiledProblem, Problem, compile_problem, require_derivatives

from . import accounts, barrier
from .iterate import Evaluator, Iterate, PhaseDual, PhaseValues, penalty_cost, running_cost
from .options import Options
from .record import Record
from .riccati import Direction, LqPhase, Sweep, backward, close_defects, roll_out
from .solution import PhaseSolution, Solution
from .status import Status

Array = NDArray[np.float64]


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
        require_derivatives(problem, "MSiLQR")
        self.problem = compile_problem(problem) if isinstance(problem, Problem) else problem
        self.evaluator = Evaluator(self.problem)

    # ---- the algorithm

    def solve(
        self, warm_start: Solution | None = None, *, progress: Callable[[Record], None] | None = None
    ) -> Solution:
        """Solve the problem.

        Args:
            warm_start: a solution of a problem with the same phases and sizes: states, controls and multipliers to
                begin with. Without it the path through the targets is the start.
            progress: called with every iteration's record.

        Returns:
            The solution; its status says how the solve ended. A solve that does not converge does not raise.

        Raises:
            SolverError: the warm start does not fit the problem.
        """
        began = time.perf_counter()
        run = Run(self, self.start(warm_start), progress)
        if warm_start is not None:
            run.resume(warm_start)
        try:
            status = run.loop()
        except KeyboardInterrupt:
            status = Status.INTERRUPTED
        return run.solution(status, time.perf_counter() - began)

    def start(self, warm_start: Solution | None) -> Iterate:
        """Return the states and controls to begin with."""
        phases = self.problem.phases
        if warm_start is None:
            return Iterate([p.guess_states for p in phases], [p.guess_controls for p in phases])
        given = warm_start.trajectory.phases
        sizes = [(p.name, p.num_stages, p.mode.state.nx, p.mode.nu) for p in phases]
        got = [(p.name, len(p.controls), p.states.shape[1], p.controls.shape[1]) for p in given]
        if [s[1:] for s in sizes] != [g[1:] for g in got]:
            raise SolverError(
                f"warm start: does not fit the problem - got phases {got}, expected {sizes} (name, stages, nx, nu); "
                "pass a solution of the same phases, or none"
            )
        return Iterate([p.states.copy() for p in given], [p.controls.copy() for p in given])


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
        self.since = 0

    def first_dual(self, i: int) -> PhaseDual:
        """Return fresh barrier and multiplier state for a phase."""
        phase, o = self.problem.phases[i], self.o
        return PhaseDual(
            relaxation=np.full(phase.g_mask.shape, o.relaxation), end_relaxation=np.full(phase.end_g_mask.shape, o.relaxation),
            shift=np.zeros(phase.g_mask.shape), end_shift=np.zeros(phase.end_g_mask.shape),
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
        self.since += 1
        if self.since >= self.o.max_inner and self.current.max_defect < 0.05:
            self.since = 0
            return True
        scale = 1 + abs(self.current.cost)
        tolerance = max(self.o.cost_tolerance, 0.1 * self.weight * self.o.barrier_gap) * scale
        return abs(expected) < tolerance and self.current.max_defect < self.o.max_defect

    def finish(self, equality: float, inequality: float) -> bool:
        """Return whether everything is met; otherwise move barrier and multipliers on."""
        done = equality <= self.o.max_equality and inequality <= self.o.max_inequality and self.current.max_defect < self.o.max_defect
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
            slack, floor = 0.25 * self.o.max_inequality, float(np.sqrt(self.weight / self.o.max_stiffness))
            d.shift = np.where(d.relaxation <= 1.01 * floor, barrier.recentre(d.shift, v.g, p.g_mask, slack), d.shift)
            d.end_shift = np.where(
                d.end_relaxation <= 1.01 * floor, barrier.recentre(d.end_shift, v.end_g, p.end_g_mask, slack), d.end_shift
            )
            d.relaxation = barrier.shrink(d.relaxation, v.g, p.g_mask, slack, floor)
            d.end_relaxation = barrier.shrink(d.end_relaxation, v.end_g, p.end_g_mask, slack, floor)

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
        needed = max(change, 0.0) / ((1 - o.merit_margin) * gap) if gap > 1e-12 else 0.0
        self.rho = max(needed, 0.5 * self.rho, o.merit_offset)
        before = self.augmented(self.current) + self.rho * gap
        size = 1.0
        while size >= o.min_step:
            trial = self.trial(self.current.iterate, direction.dx, direction.du, size)
            expected = size * direction.dV1 + 0.5 * size**2 * direction.dV2 - size * self.rho * gap
            bound = before + o.armijo * expected + 1e-12 * abs(before)
            for _ in range(o.corrections + 1):
                merit = self.augmented(trial) + self.rho * trial.gap
                if not np.isfinite(merit):
                    break
                if merit <= bound:
                    self.current = trial
                    return size
                if trial.gap < (1 - size) * gap + 0.1 * size * gap:
                    break
                trial = self.trial(trial.iterate, *close_defects(self.models, self.sweeps, trial.defects), 1.0)
            size *= o.step_shrink
        return 0.0

    def trial(self, start: Iterate, dx: list[Array], du: list[Array], size: float) -> Evaluated:
        """Return the iterate a step away."""
        states, controls = [], []
        for i, phase in enumerate(self.problem.phases):
            states.append(phase.mode.state.np_plus(start.states[i], size * dx[i]))
            controls.append(start.controls[i] + size * du[i])
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

    # ---- the result

    def resume(self, solution: Solution) -> None:
        """Take multipliers, penalties, relaxations and ε from an earlier solution."""
        self.weight = solution.barrier_weight
        for dual, phase in zip(self.duals, solution.phases, strict=True):
            stored = phase.multipliers
            if stored["equality"].shape != dual.multiplier.shape or stored["relaxation"].shape != dual.relaxation.shape:
                continue  # the constraints changed since: begin afresh there
            dual.multiplier, dual.end_multiplier = stored["equality"].copy(), stored["end_equality"].copy()
            dual.penalty, dual.end_penalty = stored["penalty"].copy(), stored["end_penalty"].copy()
            dual.relaxation, dual.end_relaxation = stored["relaxation"].copy(), stored["end_relaxation"].copy()
            dual.shift, dual.end_shift = stored["shift"].copy(), stored["end_shift"].copy()

    def solution(self, status: Status, wall_s: float) -> Solution:
        """Return the current iterate as a solution."""
        at, problem = self.current, self.problem
        models, regularization = self.linearise(), 0.0
        sweeps = backward(models, regularization)
        while sweeps is None and regularization < self.o.max_regularization:
            regularization = max(10 * regularization, self.o.regularization)
            sweeps = backward(models, regularization)
        equality, inequality = self.violations(at)
        phases = []
        for i, phase in enumerate(problem.phases):
            dual, value = self.duals[i], at.values[i]
            push, end_push = accounts.inequality_multipliers(value, dual, self.weight)
            multipliers = {
                "equality": dual.multiplier, "end_equality": dual.end_multiplier, "penalty": dual.penalty,
                "end_penalty": dual.end_penalty, "relaxation": dual.relaxation, "end_relaxation": dual.end_relaxation,
                "shift": dual.shift, "end_shift": dual.end_shift,
                "inequality": push * phase.g_mask, "end_inequality": end_push * phase.end_g_mask,
            }  # fmt: skip
            sweep = sweeps[i] if sweeps is not None else blank(models[i])
            policy = {name: getattr(sweep, name) for name in SWEEP_FIELDS}
            phases.append(PhaseSolution(**policy, defects=at.defects[i], multipliers=multipliers, target_states=phase.guess_states))
        return Solution(
            status=status, trajectory=accounts.trajectory(self.evaluator, at.iterate, at.values), phases=tuple(phases),
            history=tuple(self.history), cost=at.cost, max_defect=at.max_defect, max_equality=equality,
            max_inequality=inequality, term_costs=accounts.term_costs(problem, at.values),
            violations=accounts.violations(problem, at.values, self.duals, self.weight), barrier_weight=self.weight,
            wall_s=wall_s, compile_s=problem.compile_s,
            models={p.mode.model.name: p.mode.model.recipe() for p in problem.phases}, limits=accounts.limits(problem),
        )  # fmt: skip


SWEEP_FIELDS = ("feedforward", "feedback", "V_x", "V_xx", "Q_x", "Q_u", "Q_xx", "Q_ux", "Q_uu")


def blank(model: LqPhase) -> Sweep:
    """Return a sweep of zeros, for an iterate at which no sweep succeeds."""
    n, ndx, nu = model.B.shape
    return Sweep(
        np.zeros((n, nu)), np.zeros((n, nu, ndx)), np.zeros((n + 1, ndx)), np.zeros((n + 1, ndx, ndx)), np.zeros((n, ndx)),
        np.zeros((n, nu)), np.zeros((n, ndx, ndx)), np.zeros((n, nu, ndx)), np.zeros((n, nu, nu)),
    )  # fmt: skip
