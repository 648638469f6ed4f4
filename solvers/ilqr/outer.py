"""The outer loop: barrier weight, relaxations and shifts of inequalities, multipliers and penalties of equalities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import CompiledProblem

from .. import constants
from . import barrier
from .iterate import PhaseDual, PhaseValues, masked
from .options import Options
from .warm_start import WarmStart

Array = NDArray[np.float64]


class Outer:
    """The parameters of the sub-problem, and their updates between sub-problems.

    Args:
        problem: the problem.
        options: initial values, factors and limits.
    """

    def __init__(self, problem: CompiledProblem, options: Options) -> None:
        self.problem, self.o = problem, options
        self.weight = options.barrier_weight
        self.duals = [self._first(i) for i in range(len(problem.phases))]
        self.has_inequalities = any(p.g_mask.any() or p.end_g_mask.any() for p in problem.phases)
        self.last_equality = np.inf
        self.last_cost: float | None = None
        self.unmoved = 0
        self.last_violation = np.inf

    def _first(self, i: int) -> PhaseDual:
        phase, o = self.problem.phases[i], self.o
        return PhaseDual(
            relaxation=np.full(phase.g_mask.shape, o.relaxation),
            end_relaxation=np.full(phase.end_g_mask.shape, o.relaxation),
            shift=np.zeros(phase.g_mask.shape), end_shift=np.zeros(phase.end_g_mask.shape),
            multiplier=np.zeros(phase.h_mask.shape), penalty=np.full(phase.h_mask.shape, o.penalty),
            end_multiplier=np.zeros(phase.end_h_mask.shape), end_penalty=np.full(phase.end_h_mask.shape, o.penalty),
        )  # fmt: skip

    def resume(self, start: WarmStart) -> None:
        """Copy barrier weight, relaxations, shifts, multipliers and penalties from an earlier solve."""
        self.weight = start.barrier_weight
        self.last_cost = start.cost if start.converged else None
        for dual, stored in zip(self.duals, start.multipliers, strict=True):
            if any(np.shape(stored[name]) != table.shape for name, table in dual.stored().items()):
                continue  # the constraints have changed: keep the initial values
            dual.multiplier, dual.end_multiplier = stored["equality"].copy(), stored["end_equality"].copy()
            dual.penalty, dual.end_penalty = stored["penalty"].copy(), stored["end_penalty"].copy()
            dual.relaxation, dual.end_relaxation = stored["relaxation"].copy(), stored["end_relaxation"].copy()
            dual.shift, dual.end_shift = stored["shift"].copy(), stored["end_shift"].copy()

    def gap_is_closed(self, cost: float) -> bool:
        """Return whether the barrier hardly changes the solution: the last decrease of ε hardly changed the cost."""
        if not self.has_inequalities:
            return True
        return self.last_cost is not None and abs(cost - self.last_cost) <= self.allowed(cost)

    def allowed(self, cost: float) -> float:
        """Return the accepted suboptimality of the barrier."""
        return self.o.barrier_gap * (1 + abs(cost))

    def near_gap(self, values: list[PhaseValues]) -> float:
        """Return ε times the summed time of rows near their bound, an estimate of the barrier's suboptimality."""
        total = 0.0
        for p, v in zip(self.problem.phases, values, strict=True):
            total += p.dt * float(np.sum((v.g < constants.NEAR_BOUND * self.o.relaxation) & (p.g_mask > 0)))
        return self.weight * total

    def update(
        self, values: list[PhaseValues], cost: float, violations: tuple[float, float], *, stationary: bool
    ) -> None:
        """Set the parameters of the next sub-problem.

        Args:
            values: values of the functions of the phases.
            cost: declared cost.
            violations: largest equality and inequality violation.
            stationary: whether the last sub-problem was solved; the cost of an unsolved one is not compared.
        """
        before = self.weight
        nearly_met = violations[1] <= constants.NEARLY_MET * self.o.max_inequality
        if stationary and nearly_met and not self.gap_is_closed(cost):
            self.last_cost = cost
            self.weight = max(self.weight * self.o.barrier_factor, self.o.min_barrier_weight)
        elif not stationary and self.near_gap(values) > self.allowed(cost):
            self.last_cost = None
            self.weight = max(self.weight * self.o.barrier_factor, self.o.min_barrier_weight)
        self._update_inequalities(values, self.weight / before)
        self._update_equalities(values, violations[0])
        if stationary:
            self._watch(values, violations)

    def _watch(self, values: list[PhaseValues], violations: tuple[float, float]) -> None:
        """Count consecutive solved sub-problems that did not reduce the violation although :meth:`_pushes_hardest`."""
        now = max(violations[0] / self.o.max_equality, violations[1] / self.o.max_inequality)
        remains = now > 1 and now > constants.NO_PROGRESS * self.last_violation
        stays = remains and self._pushes_hardest(values)
        self.unmoved = self.unmoved + 1 if stays else 0
        self.last_violation = now

    def _pushes_hardest(self, values: list[PhaseValues]) -> bool:
        """Return whether every violated row has the largest penalty or the smallest relaxation."""
        floor, slack, limit = constants.AT_FLOOR * self.floor, self.o.max_inequality, self.o.max_equality
        for v, d, p in zip(values, self.duals, self.problem.phases, strict=True):
            soft = [
                (v.g < -slack) & (p.g_mask > 0) & (d.relaxation > floor),
                (v.end_g < -slack) & (p.end_g_mask > 0) & (d.end_relaxation > floor),
                (np.abs(v.h) > limit) & (p.h_mask > 0) & (d.penalty < self.o.max_penalty),
                (np.abs(v.end_h) > limit) & (p.end_h_mask > 0) & (d.end_penalty < self.o.max_penalty),
            ]
            if any(np.any(rows) for rows in soft):
                return False
        return True

    @property
    def floor(self) -> float:
        """Smallest relaxation at the present ε, at which the stiffness is ``max_stiffness``."""
        return float(np.sqrt(self.weight / self.o.max_stiffness))

    @property
    def is_stuck(self) -> bool:
        """Whether larger penalties and smaller relaxations no longer reduce the violation."""
        return self.unmoved > constants.MAX_UNMOVED

    def _update_inequalities(self, values: list[PhaseValues], drop: float) -> None:
        """Set relaxations and shifts.

        Args:
            values: values of the functions of the phases.
            drop: factor by which ε has just decreased, 1 if it has not.
        """
        slack, floor = constants.SLACK * self.o.max_inequality, self.floor
        for v, d, p in zip(values, self.duals, self.problem.phases, strict=True):
            if drop < 1.0:
                d.relaxation = barrier.follow(d.relaxation, v.g, d.shift, p.g_mask, drop, floor)
                d.end_relaxation = barrier.follow(d.end_relaxation, v.end_g, d.end_shift, p.end_g_mask, drop, floor)
            at, end_at = (delta <= constants.AT_FLOOR * floor for delta in (d.relaxation, d.end_relaxation))
            d.shift = np.where(at, barrier.recentre(d.shift, v.g, p.g_mask, slack), d.shift)
            d.end_shift = np.where(end_at, barrier.recentre(d.end_shift, v.end_g, p.end_g_mask, slack), d.end_shift)
            d.relaxation = barrier.shrink(d.relaxation, v.g, p.g_mask, slack, floor)
            d.end_relaxation = barrier.shrink(d.end_relaxation, v.end_g, p.end_g_mask, slack, floor)

    def _update_equalities(self, values: list[PhaseValues], equality: float) -> None:
        slow = equality > constants.SLOW_DECREASE * self.last_equality and equality > self.o.max_equality
        self.last_equality = equality
        factor = self.o.penalty_factor if slow else 1.0
        for v, d, p in zip(values, self.duals, self.problem.phases, strict=True):
            d.multiplier = d.multiplier + masked(p.h_mask, d.penalty * v.h)
            d.end_multiplier = d.end_multiplier + masked(p.end_h_mask, d.end_penalty * v.end_h)
            d.penalty = np.minimum(d.penalty * factor, self.o.max_penalty)
            d.end_penalty = np.minimum(d.end_penalty * factor, self.o.max_penalty)
