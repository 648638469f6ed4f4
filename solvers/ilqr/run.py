"""One solve: line search, regularisation and the loop around the linear-quadratic model."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import constants
from ..solution import Record, SearchState, Status, is_same
from .iterate import Iterate, PhaseValues, ProblemFunctions, masked, penalty_cost, running_cost
from .options import Options
from .outer import Outer
from .riccati import Direction, LqPhase, Sweep, backward, close_defects, roll_out
from .rollout import Flags, move
from .warm_start import WarmStart

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Evaluated:
    """An iterate with its values, defects, declared cost, and the natural sizes of the states of every phase."""

    iterate: Iterate
    values: list[PhaseValues]
    defects: list[Array]
    cost: float
    sizes: list[Array]

    @property
    def gap(self) -> float:
        """Sum of the absolute values of all defects in natural sizes, which the merit weights by ρ."""
        return float(sum(np.sum(np.abs(d) / size) for d, size in zip(self.defects, self.sizes, strict=True)))

    @property
    def max_defect(self) -> float:
        """Largest defect, ∞-norm in the tangent, in natural sizes."""
        parts = zip(self.defects, self.sizes, strict=True)
        return float(max(np.max(np.abs(d) / size, initial=0.0) for d, size in parts))


class Run:
    """One solve: its current iterate, the parameters of its sub-problem and its history.

    Args:
        functions: the problem's functions.
        options: options.
        start: the first iterate.
        shooting: which nodes are shooting nodes.
        report: called with the record of every iteration.
    """

    def __init__(
        self,
        functions: ProblemFunctions,
        options: Options,
        start: Iterate,
        shooting: list[Flags],
        report: Callable[[Record], None] | None,
    ) -> None:
        self.o, self.problem, self.functions = options, functions.problem, functions
        self.shooting, self.report = shooting, report
        self.began = time.perf_counter()
        self.outer = Outer(functions.problem, options)
        self.current = self.evaluate(start)
        self.history: list[Record] = []
        self.models: list[LqPhase] = []
        self.sweeps: list[Sweep] = []
        self.policy: list[Sweep] | None = None  # at the last iterate, if the backend has computed it
        self.regularization = 0.0
        self.step_size = 1.0
        self.rho = self.least_rho = options.merit_offset
        self.inner = 0
        self.gains: list[float] = []
        self.outside: Iterate | None = None  # the last trial since the previous iterate whose merit was not finite

    # ---- warm start

    def resume(self, start: WarmStart) -> None:
        """Copy barrier and multipliers from an earlier solve; for the same problem also the state of the search."""
        self.outer.resume(start)
        state = start.search
        if state is not None and is_same(
            self.augmented(self.current) + state.rho * self.current.gap, state.merit, self.outer.size(state.merit)
        ):
            self.restore(state)

    def restore(self, state: SearchState) -> None:
        """Set the state of the search."""
        self.rho, self.least_rho, self.regularization = state.rho, state.least_rho, state.regularization
        self.step_size, self.gains, self.inner = state.step_size, list(state.gains), state.inner
        self.outer.unmoved, self.outer.last_cost = state.unmoved, state.last_cost
        self.outer.last_equality, self.outer.last_violation = state.last_equality, state.last_violation
        self.outer.last_inequality = state.last_inequality
        self.outer.stiffness = state.stiffness or self.o.stiffness

    def search_state(self) -> SearchState:
        """Return the state of the search, from which a later solve can continue."""
        return SearchState(
            merit=self.augmented(self.current) + self.rho * self.current.gap, rho=self.rho, least_rho=self.least_rho,
            regularization=self.regularization, step_size=self.step_size,
            gains=tuple(self.gains[-constants.PATIENCE :]), inner=self.inner, unmoved=self.outer.unmoved,
            last_equality=float(self.outer.last_equality), last_violation=float(self.outer.last_violation),
            last_cost=self.outer.last_cost, last_inequality=float(self.outer.last_inequality),
            stiffness=self.outer.stiffness,
        )  # fmt: skip

    # ---- evaluation

    def evaluate(self, iterate: Iterate) -> Evaluated:
        """Return an iterate's values, defects and declared cost."""
        values = self.functions.all_values(iterate)
        cost = sum(running_cost(p, v) for p, v in zip(self.problem.phases, values, strict=True))
        sizes = [phase.mode.state_sizes for phase in self.problem.phases]
        return Evaluated(iterate, values, self.functions.defects(iterate, values), float(cost), sizes)

    def augmented(self, at: Evaluated) -> float:
        """Return cost plus barrier plus augmented Lagrangian."""
        parts = zip(self.problem.phases, at.values, self.outer.duals, strict=True)
        return at.cost + sum(penalty_cost(p, v, d, self.outer.weight) for p, v, d in parts)

    def violations(self, at: Evaluated) -> tuple[float, float]:
        """Return the largest equality and inequality violations."""
        h, g = [0.0], [0.0]
        for p, v in zip(self.problem.phases, at.values, strict=True):
            for values, mask in ((v.h, p.h_mask), (v.end_h, p.end_h_mask)):
                h.append(np.max(np.abs(masked(mask, values)), initial=0.0))
            for values, mask in ((v.g, p.g_mask), (v.end_g, p.end_g_mask)):
                g.append(np.max(-masked(mask, values), initial=0.0))
        return float(max(h)), float(max(g))

    def linearise(self, share: float = 1.0) -> list[LqPhase]:
        """Return the linear-quadratic model at the current iterate, with a share of the cost."""
        at, outer = self.current, self.outer
        return [
            self.functions.lq(i, at.iterate, at.values[i], at.defects[i], outer.duals[i], outer.weight, share)
            for i in range(len(self.problem.phases))
        ]

    # ---- the loop

    def loop(self) -> Status:
        """Iterate until the solve ends; return its status."""
        if not np.isfinite(self.augmented(self.current) + self.current.gap):
            return Status.NOT_FINITE
        self.models = self.linearise()
        while True:
            direction = self.direction()
            if direction is None:
                return self.failed()
            stationary = self.is_stationary(direction)
            if stationary and self.is_blocked():
                return Status.NOT_FINITE
            if stationary and self.meets_everything():
                return Status.CONVERGED
            if stationary and not self.o.adapt:
                return Status.STATIONARY
            if len(self.history) >= self.o.max_iterations:
                return Status.ITERATION_LIMIT
            if stationary or self.is_due():
                direction = self.advance(stationary=stationary)
                if self.outer.is_stuck and not self.can_improve():
                    return Status.INFEASIBLE
                if direction is None:
                    return self.failed()
            size = self.search(direction)
            if size is None:
                return Status.TIME_LIMIT
            self.adapt(size)
            self.record(direction, size)
            if self.regularization > self.o.max_regularization:
                return self.failed()
            if size > 0.0:
                self.models = self.linearise()

    def failed(self) -> Status:
        """Return the status of a solve without a further step.

        A number is not finite, violations remain that no step reduces, or the line search failed.
        """
        if self.outside is not None or not all(model.is_finite for model in self.models):
            return Status.NOT_FINITE
        violation = self.outer.measure(self.violations(self.current))
        if not self.o.adapt or not violation > 1 or self.current.max_defect >= constants.NEARLY_CLOSED:
            return Status.LINE_SEARCH_FAILED
        self.outer.last_violation, self.regularization = violation, 0.0
        return Status.LINE_SEARCH_FAILED if self.can_improve() else Status.INFEASIBLE

    def is_stationary(self, direction: Direction) -> bool:
        """Return whether the sub-problem is solved: the expected decrease, or the last decreases, are negligible."""
        tolerance = self.o.cost_tolerance * self.outer.size(self.current.cost)
        nothing_expected = abs(direction.dV1 + 0.5 * direction.dV2) < tolerance
        last = self.gains[-constants.PATIENCE :]
        nothing_gained = len(last) == constants.PATIENCE and max(last) < tolerance
        return (nothing_expected or nothing_gained) and self.current.max_defect < self.o.max_defect

    def is_blocked(self) -> bool:
        """Return whether the iterate is stationary only because of the regularisation that keeps the merit finite."""
        if self.outside is None or self.regularization <= self.o.regularization:
            return False
        sweeps = backward(self.models, self.o.regularization)
        if sweeps is None:
            return False
        direction = roll_out(self.models, sweeps)
        return not abs(direction.dV1 + 0.5 * direction.dV2) < self.o.cost_tolerance * self.outer.size(self.current.cost)

    def is_due(self) -> bool:
        """Return whether to leave the sub-problem unsolved: it has had its iterations, and tolerances are not met."""
        is_early = self.inner < self.o.max_inner or self.current.max_defect >= constants.NEARLY_CLOSED
        if is_early or not self.o.adapt:
            return False
        return not self.keeps_tolerances() or self.outer.near_gap(self.current.values) > self.outer.allowed(
            self.current.cost
        )

    def meets_everything(self) -> bool:
        """Return whether every tolerance is met and neither barrier nor violations change the solution much."""
        at, outer = self.current, self.outer
        return (
            self.keeps_tolerances() and outer.gap_is_closed(at.values, at.cost) and outer.is_exact(at.values, at.cost)
        )

    def keeps_tolerances(self) -> bool:
        """Return whether every constraint is met within its tolerance."""
        equality, inequality = self.violations(self.current)
        return equality <= self.o.max_equality and inequality <= self.o.max_inequality

    def advance(self, *, stationary: bool) -> Direction | None:
        """Begin the next sub-problem and return its direction."""
        at = self.current
        self.outer.update(at.values, at.cost, self.violations(at), stationary=stationary)
        self.inner = 0
        self.gains = []
        self.models = self.linearise()
        return self.direction()

    def can_improve(self) -> bool:
        """Return whether a step that hardly regards the cost reduces the violation; if so, the search goes on."""
        kept = self.models, self.sweeps, self.regularization
        self.models = self.linearise(constants.SHARE_OF_COST)
        direction, improved, size = self.direction(), False, 1.0
        while direction is not None and not improved and size >= constants.SHORTEST_ATTEMPT:
            at = self.trial(self.current.iterate, direction.dx, direction.du, size)
            improved = self.outer.measure(self.violations(at)) < constants.IMPROVED * self.outer.last_violation
            size *= self.o.step_shrink
        self.models, self.sweeps, self.regularization = kept
        if improved:
            self.outer.unmoved = 0
        return improved

    def record(self, direction: Direction, size: float) -> None:
        """Append the record of an iteration to the history and report it."""
        equality, inequality = self.violations(self.current)
        record = Record(
            iteration=len(self.history) + 1, cost=self.current.cost,
            merit=self.augmented(self.current) + self.rho * self.current.gap,
            expected=-(direction.dV1 + 0.5 * direction.dV2), max_defect=self.current.max_defect, max_equality=equality,
            max_inequality=inequality, step_size=size, regularization=self.regularization,
            barrier_weight=self.outer.weight, wall_s=time.perf_counter() - self.began,
        )  # fmt: skip
        self.history.append(record)
        if self.report:
            self.report(record)

    def is_late(self) -> bool:
        """Return whether the time limit is over."""
        return self.o.time_limit_s is not None and time.perf_counter() - self.began > self.o.time_limit_s

    # ---- one iteration

    def direction(self) -> Direction | None:
        """Return the step of the linear-quadratic model; raise the regularisation until the sweep succeeds."""
        while self.regularization <= self.o.max_regularization:
            sweeps = backward(self.models, self.regularization)
            if sweeps is not None:
                self.sweeps = sweeps
                direction = roll_out(self.models, sweeps)
                if np.isfinite(direction.dV1 + direction.dV2):
                    return direction
            self.raise_regularization()
        return None

    def raise_regularization(self) -> None:
        """Raise the regularisation."""
        self.regularization = max(constants.REGULARIZATION_FACTOR * self.regularization, self.o.regularization)

    def adapt(self, size: float) -> None:
        """Lower the regularisation after a long step, raise it after a short or failed one."""
        self.inner += 1
        self.step_size = size
        if size == 0.0:
            for _ in range(constants.RAISES_AFTER_FAILURE):
                self.raise_regularization()
        elif size > constants.LONG_STEP:
            lower = self.regularization / constants.REGULARIZATION_FACTOR
            self.regularization = lower if self.regularization > self.o.regularization else 0.0
        elif size < constants.SHORT_STEP:
            self.raise_regularization()

    def update_merit(self, direction: Direction) -> None:
        """Choose the weight ρ of the defects so that the model predicts a decrease of the merit.

        ρ decreases slowly: if it is smaller than the multipliers, cost and defects decrease in turn and increase again.
        If that happens, the sub-problem takes many iterations, and the smallest ρ is doubled.
        """
        gap, change = self.current.gap, direction.dV1 + 0.5 * max(direction.dV2, 0.0)
        needed = max(change, 0.0) / ((1 - self.o.merit_margin) * gap) if gap > constants.SMALLEST_GAP else 0.0
        if self.inner > constants.LONG_SUBPROBLEM * self.o.max_inner and self.inner % self.o.max_inner == 0:
            self.least_rho *= constants.LEAST_RHO_FACTOR
        self.rho = max(needed, constants.RHO_DECAY * self.rho, self.least_rho)

    def search(self, direction: Direction) -> float | None:
        """Return the step size that the line search accepts, 0 if none; set the current iterate.

        A trial whose defects grow because of curvature gets a second-order correction before a shorter step is tried.
        None, and no change of iterate and search, if the time is over before a trial.
        """
        given = self.rho, self.least_rho, self.outside
        self.update_merit(direction)
        gap = self.current.gap
        before = self.augmented(self.current) + self.rho * gap
        grown = self.step_size / self.o.step_shrink**constants.STEPS_BACK
        size = min(1.0, grown) if self.step_size > 0 else 1.0
        left = False
        while size >= self.o.min_step:
            expected = size * direction.dV1 + 0.5 * size**2 * direction.dV2 - size * self.rho * gap
            bound = before + self.o.armijo * expected + constants.MERIT_ROUNDING * abs(before)
            step = self.current.iterate, direction.dx, direction.du, size
            for correction in range(self.o.corrections + 1):
                if self.is_late():
                    self.rho, self.least_rho, self.outside = given
                    return None
                trial = self.trial(*step)
                merit = self.augmented(trial) + self.rho * trial.gap
                if not np.isfinite(merit):
                    self.outside, left = trial.iterate, True
                if np.isfinite(merit) and merit <= bound:
                    self.current = trial
                    self.outside = self.outside if left else None
                    self.gains.append(before - merit)
                    return size
                defects_grew = np.isfinite(merit) and trial.gap > (1 - constants.GAP_DECREASE * size) * gap
                if not defects_grew or correction == self.o.corrections:
                    break
                step = trial.iterate, *close_defects(self.models, self.sweeps, trial.defects), 1.0
            size *= self.o.step_shrink
        return 0.0

    def trial(self, start: Iterate, dx: list[Array], du: list[Array], size: float) -> Evaluated:
        """Return the iterate after a step."""
        feedback = [sweep.feedback for sweep in self.sweeps]
        return self.evaluate(move(self.functions, start, dx, du, size, self.shooting, feedback))
