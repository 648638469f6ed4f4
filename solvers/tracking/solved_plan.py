"""A solution as a plan for low-level controllers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from piaffe.errors import SolverError
from piaffe.ocp import CompiledProblem, LoweredMode, Problem, check_fits, compile_problem

from ..solution import Solution
from .plan import PlanPhase


class SolvedPlan:
    """A solution as a plan.

    The expansions of the action value are those of the solver's last backward sweep. They contain the barrier of the
    inequalities and the augmented Lagrangian of the equalities. Phases from the first one with states of another size
    on are left out.

    Args:
        solution: the solution.
        problem: its problem.

    Raises:
        ProblemError: the solution is not of this problem.
        SolverError: the solution has no policy.
    """

    def __init__(self, solution: Solution, problem: Problem | CompiledProblem) -> None:
        compiled = problem if isinstance(problem, CompiledProblem) else compile_problem(problem, checks=False)
        check_fits(compiled, solution.trajectory)
        self._compiled = compiled
        phases = []
        for phase, part, policy in zip(compiled.phases, solution.trajectory.phases, solution.phases, strict=True):
            if phase.mode.state.nx != compiled.phases[0].mode.state.nx:
                break
            if policy.Q_uu.size and not np.all(np.linalg.eigvalsh(policy.Q_uu)[:, 0] > 0):
                raise SolverError(
                    f"plan, phase '{part.name}': the solution has no policy - got a Hessian of the action value that "
                    f"is not positive definite (status {solution.status.name}), expected one; solve until it converges"
                )
            phases.append(
                PlanPhase(
                    mode=phase.mode,
                    times=part.times,
                    states=part.states,
                    controls=part.controls,
                    feedback=policy.feedback,
                    Q_u=policy.Q_u,
                    Q_ux=policy.Q_ux,
                    Q_uu=policy.Q_uu,
                    p=phase.p,
                    g_mask=phase.g_mask,
                    h_mask=phase.h_mask,
                )
            )
        self._phases = tuple(phases)

    @property
    def phases(self) -> Sequence[PlanPhase]:
        """The phases, in the order of time."""
        return self._phases

    def row_name(self, mode: LoweredMode, kind: str, row: int) -> str:
        """Return the name of a row of a mode's stages: term, component and side."""
        return self._compiled.row_name(mode.rows[f"stage_{kind}"][row])
