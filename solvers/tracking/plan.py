"""What a low-level controller needs of a plan at one time, and solutions as such plans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError
from piaffe.ocp import CompiledProblem, LoweredMode, Problem, check_fits, compile_problem, interpolate, node_before
from piaffe.ocp import phase_index as phase_at

from ..solution import Solution

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlanStage:
    """A plan at one time.

    Args:
        mode: the mode of the stage: its functions, rows and state space.
        x: x̄, interpolated between the nodes of a phase, never across a reset (nx,).
        u: ū of the stage (nu,).
        feedback: K of the stage (nu, ndx).
        Q_u: gradient of the action value by the control (nu,).
        Q_ux: mixed second derivatives of the action value (nu, ndx).
        Q_uu: Hessian of the action value by the control (nu, nu).
        p: parameters of the stage (np,).
        g_mask: 0 or 1 per inequality row (ng,).
        h_mask: 0 or 1 per equality row (nh,).
    """

    mode: LoweredMode
    x: Array
    u: Array
    feedback: Array
    Q_u: Array
    Q_ux: Array
    Q_uu: Array
    p: Array
    g_mask: Array
    h_mask: Array


class StagedPlan(Protocol):
    """A plan that a low-level controller follows."""

    @property
    def modes(self) -> Sequence[LoweredMode]:
        """The modes of its stages, each once."""
        ...

    def row_name(self, mode: LoweredMode, kind: str, row: int) -> str:
        """Return the name of a row ``"g"`` or ``"h"`` of a mode's stages."""
        ...

    def at(self, t: float) -> PlanStage:
        """Return the plan at time t [s]; before its start and after its end, the first or last stage and state."""
        ...


class SolvedPlan:
    """A solution as a plan.

    The expansions of the action value are those of the solver's last backward sweep. They contain the barrier of the
    inequalities and the augmented Lagrangian of the equalities.

    Args:
        solution: the solution.
        problem: its problem.
        phases: number of phases that belong to the plan; by default those before the first with states of another size.

    Raises:
        ProblemError: the solution is not of this problem.
        SolverError: the solution has no policy.
    """

    def __init__(self, solution: Solution, problem: Problem | CompiledProblem, *, phases: int | None = None) -> None:
        compiled = problem if isinstance(problem, CompiledProblem) else compile_problem(problem, checks=False)
        check_fits(compiled, solution.trajectory)
        parts = solution.trajectory.phases
        nx = parts[0].states.shape[1]
        same = next((i for i, part in enumerate(parts) if part.states.shape[1] != nx), len(parts))
        self._count = same if phases is None else phases
        self._compiled, self._solution = compiled, solution
        for part, policy in zip(parts[: self._count], solution.phases, strict=False):
            if policy.Q_uu.size and not np.all(np.linalg.eigvalsh(policy.Q_uu)[:, 0] > 0):
                raise SolverError(
                    f"plan, phase '{part.name}': the solution has no policy - got a Hessian of the action value that "
                    f"is not positive definite (status {solution.status.name}), expected one; solve until it converges"
                )

    @property
    def modes(self) -> Sequence[LoweredMode]:
        """The modes of its stages, each once."""
        return tuple(dict.fromkeys(phase.mode for phase in self._compiled.phases[: self._count]))

    def row_name(self, mode: LoweredMode, kind: str, row: int) -> str:
        """Return the name of a row of a mode's stages: term, component and side."""
        return self._compiled.row_name(mode.rows[f"stage_{kind}"][row])

    def at(self, t: float) -> PlanStage:
        """Return the plan at time t [s]; on a boundary of phases, the later phase applies."""
        i = min(phase_at(self._solution.trajectory, t), self._count - 1)
        part, policy, phase = self._solution.trajectory.phases[i], self._solution.phases[i], self._compiled.phases[i]
        k, _ = node_before(part, t)
        return PlanStage(
            mode=phase.mode, x=interpolate(part, part.states, t), u=part.controls[k], feedback=policy.feedback[k],
            Q_u=policy.Q_u[k], Q_ux=policy.Q_ux[k], Q_uu=policy.Q_uu[k], p=phase.p[k], g_mask=phase.g_mask[k],
            h_mask=phase.h_mask[k],
        )  # fmt: skip
