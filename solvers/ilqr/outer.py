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
        self.time = options.number("time_scale")
        self.scale, self.smallest = options.number("cost_scale"), options.number("cost_floor")
        self.duals = [self._first(i) for i in range(len(problem.phases))]
        self.has_inequalities = any(p.g_mask.any() or p.end_g_mask.any() for p in problem.phases)
        self.stiffness = options.stiffness
        self.last_equality = self.last_inequality = np.inf
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
            end_multiplier=np.zeros(phase.end_h_mask.shape),
            end_penalty=np.full(phase.end_h_mask.shape, o.penalty * self.time),
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

    def gap_is_closed(self, values: list[PhaseValues], cost: float) -> bool:
        """Return whether the barrier hardly changes the solution: the last decrease of ε hardly changed the cost."""
        if not self.has_inequalities:
            return True
        if self.last_cost is None:
            return False
        return abs(cost + self.saved(values)[0] - self.last_cost) <= self.allowed(cost)

    def is_exact(self, values: list[PhaseValues], cost: float) -> bool:
        """Return whether the violations that remain hardly change the cost."""
        return self.saved(values)[1] <= self.allowed(cost)

    def saved(self, values: list[PhaseValues]) -> tuple[float, float]:
        """Return what the violations save of the cost, to first order, and the sum of absolute values of the parts.

        A row saves its multiplier times its violation. Both are 0 for a solve that does not adapt.
        """
        total = size = 0.0
        if self.o.adapt:
            for p, v, d in zip(self.problem.phases, values, self.duals, strict=True):
                stage = masked(p.g_mask, self._pushes(v.g, d.shift, d.relaxation) * np.minimum(v.g, 0.0))
                end = masked(
                    p.end_g_mask, self._pushes(v.end_g, d.end_shift, d.end_relaxation) * np.minimum(v.end_g, 0.0)
                )
                h = masked(p.h_mask, (d.multiplier + d.penalty * v.h) * v.h)
                end_h = masked(p.end_h_mask, (d.end_multiplier + d.end_penalty * v.end_h) * v.end_h)
                total += p.dt * float(np.sum(stage) + np.sum(end) + np.sum(h)) + float(np.sum(end_h))
                size += p.dt * float(np.sum(stage) + np.sum(end) + np.sum(np.abs(h))) + float(np.sum(np.abs(end_h)))
        return total, size

    def _pushes(self, g: Array, shift: Array, relaxation: Array) -> Array:
        return self.weight * barrier.slope(g - shift, relaxation)

    def allowed(self, cost: float) -> float:
        """Return the accepted suboptimality of the barrier."""
        return self.o.barrier_gap * self.size(cost)

    def size(self, cost: float) -> float:
        """Return what changes of the cost are relative to."""
        return abs(cost) + min(max(abs(cost), self.smallest), self.scale)

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
        before, exact = self.weight, self._wants_exact(values, cost, violations)
        nearly_met = violations[1] <= constants.NEARLY_MET * self.o.max_inequality
        if stationary and nearly_met and not self.gap_is_closed(values, cost):
            self.last_cost = cost + self.saved(values)[0]
            self.weight = max(self.weight * self.o.barrier_factor, self.o.min_barrier_weight)
        elif not stationary and self.near_gap(values) > self.allowed(cost):
            self.last_cost = None
            self.weight = max(self.weight * self.o.barrier_factor, self.o.min_barrier_weight)
        self._update_inequalities(values, self.weight / before, exact=exact)
        if stationary:
            self._stiffen(values, violations[1], exact=exact)
        self._update_equalities(values, violations[0], exact=exact)
        self._watch(violations, stationary=stationary)

    def _wants_exact(self, values: list[PhaseValues], cost: float, violations: tuple[float, float]) -> bool:
        """Return whether violations within the tolerances still change the cost: then all of them count."""
        met = violations[0] <= self.o.max_equality and violations[1] <= self.o.max_inequality
        return met and not self.is_exact(values, cost)

    def measure(self, violations: tuple[float, float]) -> float:
        """Return the largest violation relative to its tolerance."""
        return max(violations[0] / self.o.max_equality, violations[1] / self.o.max_inequality)

    def _watch(self, violations: tuple[float, float], *, stationary: bool) -> None:
        """Count consecutive sub-problems that did not reduce the violation although each pushed harder than the last.

        After a sub-problem that was left unsolved, a violation that has increased does not count: the iterate moves.
        """
        now = self.measure(violations)
        stays = now > max(1.0, constants.NO_PROGRESS * self.last_violation)
        if not stationary:
            stays &= constants.NO_PROGRESS * now < self.last_violation
        self.unmoved = self.unmoved + 1 if stays else 0
        self.last_violation = now

    def _is_soft(self, values: list[PhaseValues], floor: float) -> bool:
        """Return whether a violated inequality has a relaxation above the smallest one."""
        slack = self.o.max_inequality
        return any(
            np.any((v.g < -slack) & (p.g_mask > 0) & (d.relaxation > floor))
            or np.any((v.end_g < -slack) & (p.end_g_mask > 0) & (d.end_relaxation > floor))
            for v, d, p in zip(values, self.duals, self.problem.phases, strict=True)
        )

    @property
    def floor(self) -> float:
        """Smallest relaxation at the present ε, at which a row has the largest curvature that is allowed now."""
        return float(np.sqrt(self.weight / self.stiffness))

    @property
    def is_stuck(self) -> bool:
        """Whether larger penalties and smaller relaxations no longer reduce the violation."""
        return self.unmoved > constants.MAX_UNMOVED

    def _update_inequalities(self, values: list[PhaseValues], drop: float, *, exact: bool) -> None:
        """Set relaxations and shifts.

        Args:
            values: values of the functions of the phases.
            drop: factor by which ε has just decreased, 1 if it has not.
            exact: whether small violations count, too.
        """
        slack, floor = 0.0 if exact else constants.SLACK * self.o.max_inequality, self.floor
        for v, d, p in zip(values, self.duals, self.problem.phases, strict=True):
            if drop < 1.0:
                d.relaxation = barrier.follow(d.relaxation, v.g, d.shift, p.g_mask, drop, floor)
                d.end_relaxation = barrier.follow(d.end_relaxation, v.end_g, d.end_shift, p.end_g_mask, drop, floor)
            at, end_at = (delta <= constants.AT_FLOOR * floor for delta in (d.relaxation, d.end_relaxation))
            d.shift = np.where(at, barrier.recentre(d.shift, v.g, p.g_mask, slack), d.shift)
            d.end_shift = np.where(end_at, barrier.recentre(d.end_shift, v.end_g, p.end_g_mask, slack), d.end_shift)
            d.relaxation = barrier.shrink(d.relaxation, v.g, p.g_mask, slack, floor)
            d.end_relaxation = barrier.shrink(d.end_relaxation, v.end_g, p.end_g_mask, slack, floor)

    def _stiffen(self, values: list[PhaseValues], inequality: float, *, exact: bool) -> None:
        """Allow stiffer rows if the violation decreases too slowly although violated rows are as stiff as allowed."""
        before, slack = self.floor, 0.0 if exact else constants.SLACK * self.o.max_inequality
        least = 0.0 if exact else self.o.max_inequality
        slow = inequality > max(least, constants.SLOW_DECREASE * self.last_inequality)
        self.last_inequality = inequality
        if not slow or self.stiffness >= self.o.max_stiffness or self._is_soft(values, constants.AT_FLOOR * before):
            return
        self.stiffness = min(self.stiffness * self.o.penalty_factor, self.o.max_stiffness)
        for v, d, p in zip(values, self.duals, self.problem.phases, strict=True):
            at, end_at = (delta <= constants.AT_FLOOR * before for delta in (d.relaxation, d.end_relaxation))
            used, end_used = (at & (p.g_mask > 0) & ((v.g < -slack) | (d.shift > 0)),
                              end_at & (p.end_g_mask > 0) & ((v.end_g < -slack) | (d.end_shift > 0)))  # fmt: skip
            d.relaxation, d.shift = barrier.stiffen(d.relaxation, d.shift, used, self.floor)
            d.end_relaxation, d.end_shift = barrier.stiffen(d.end_relaxation, d.end_shift, end_used, self.floor)

    def _update_equalities(self, values: list[PhaseValues], equality: float, *, exact: bool) -> None:
        slow = equality > max(constants.SLOW_DECREASE * self.last_equality, 0.0 if exact else self.o.max_equality)
        self.last_equality = equality
        factor = self.o.penalty_factor if slow else 1.0
        for v, d, p in zip(values, self.duals, self.problem.phases, strict=True):
            d.multiplier = d.multiplier + masked(p.h_mask, d.penalty * v.h)
            d.end_multiplier = d.end_multiplier + masked(p.end_h_mask, d.end_penalty * v.end_h)
            d.penalty = np.minimum(d.penalty * factor, self.o.max_penalty)
            d.end_penalty = np.minimum(d.end_penalty * factor, self.o.max_penalty * self.time)
