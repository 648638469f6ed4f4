"""Make the solution from the last iterate of a run."""

from __future__ import annotations

import numpy as np

from .. import constants
from ..solution import PhaseSolution, Solution, Status
from . import summary
from .riccati import LqPhase, Sweep, backward
from .run import Run

_POLICY = ("feedforward", "feedback", "V_x", "V_xx", "Q_x", "Q_u", "Q_xx", "Q_ux", "Q_uu")


def assemble(run: Run, status: Status, wall_s: float) -> Solution:
    """Return the current iterate of a run with its policy, expansions, costs and violations."""
    at, problem, outer = run.current, run.problem, run.outer
    sweeps = run.policy or sweeps_of(run)
    equality, inequality = run.violations(at)
    phases = []
    for phase, dual, value, defects, sweep in zip(
        problem.phases, outer.duals, at.values, at.defects, sweeps, strict=True
    ):
        stage_lambda, end_lambda = summary.inequality_multipliers(value, dual, outer.weight)
        multipliers = {
            "equality": dual.multiplier, "end_equality": dual.end_multiplier, "penalty": dual.penalty,
            "end_penalty": dual.end_penalty, "relaxation": dual.relaxation, "end_relaxation": dual.end_relaxation,
            "shift": dual.shift, "end_shift": dual.end_shift,
            "inequality": stage_lambda * phase.g_mask, "end_inequality": end_lambda * phase.end_g_mask,
        }  # fmt: skip
        policy = {name: getattr(sweep, name) for name in _POLICY}
        phases.append(
            PhaseSolution(**policy, defects=defects, multipliers=multipliers, target_states=phase.guess_states)
        )
    return Solution(
        status=status, trajectory=summary.trajectory(run.functions, at.iterate, at.values), phases=tuple(phases),
        history=tuple(run.history), cost=at.cost, max_defect=at.max_defect, max_equality=equality,
        max_inequality=inequality, term_costs=summary.term_costs(problem, at.values),
        violations=summary.violations(problem, at.values, outer.duals, outer.weight), barrier_weight=outer.weight,
        wall_s=wall_s, compile_s=problem.compile_s,
        models={p.mode.model.name: p.mode.model.recipe() for p in problem.phases}, limits=summary.limits(problem),
        search=run.search_state(),
    )  # fmt: skip


def sweeps_of(run: Run) -> list[Sweep]:
    """Return the sweep at a run's iterate with the smallest regularisation that succeeds; zeros if none does."""
    models, first, last = run.linearise(), run.o.regularization, run.o.max_regularization
    regularization = 0.0
    while regularization <= last:
        sweeps = backward(models, regularization)
        if sweeps is not None:
            return sweeps
        regularization = max(constants.POLICY_REGULARIZATION_FACTOR * regularization, first)
    return [_blank(model) for model in models]


def _blank(model: LqPhase) -> Sweep:
    n, ndx, nu = model.B.shape
    return Sweep(
        np.zeros((n, nu)), np.zeros((n, nu, ndx)), np.zeros((n + 1, ndx)), np.zeros((n + 1, ndx, ndx)),
        np.zeros((n, ndx)),
        np.zeros((n, nu)), np.zeros((n, ndx, ndx)), np.zeros((n, nu, ndx)), np.zeros((n, nu, nu)),
    )  # fmt: skip
