"""What a low-level controller needs of a plan at one time, and solutions as such plans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError
from piaffe.ocp import SAME_TIME, CompiledProblem, LoweredMode, Problem, check_fits, compile_problem

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


@dataclass(frozen=True, eq=False)
class PlanPhase:
    """A phase of a plan, with N stages.

    Args:
        mode: its mode.
        times: node times (N+1,) [s].
        states: (N+1, nx).
        controls: (N, nu).
        feedback: (N, nu, ndx).
        Q_u: (N, nu).
        Q_ux: (N, nu, ndx).
        Q_uu: (N, nu, nu).
        p: parameters of the stages (N, np).
        g_mask: 0 or 1 per stage and inequality row (N, ng).
        h_mask: the same for equalities (N, nh).
    """

    mode: LoweredMode
    times: Array
    states: Array
    controls: Array
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
    def phases(self) -> Sequence[PlanPhase]:
        """The phases, in the order of time; all have states of one size."""
        ...

    def row_name(self, mode: LoweredMode, kind: str, row: int) -> str:
        """Return the name of a row ``"g"`` or ``"h"`` of a mode's stages."""
        ...


def modes_of(plan: StagedPlan) -> tuple[LoweredMode, ...]:
    """Return the modes of a plan, each once."""
    return tuple(dict.fromkeys(phase.mode for phase in plan.phases))


def stage_at(plan: StagedPlan, t: float) -> PlanStage:
    """Return a plan at time t [s]; on a boundary of phases, the later phase applies.

    Before its start and after its end, its first or last stage and state apply.
    """
    phase = plan.phases[max((i for i, each in enumerate(plan.phases) if each.times[0] <= t + SAME_TIME), default=0)]
    last = len(phase.times) - 2
    k = int(np.clip(np.searchsorted(phase.times, t + SAME_TIME, side="right") - 1, 0, last))
    share = float(np.clip((t - phase.times[k]) / (phase.times[k + 1] - phase.times[k]), 0.0, 1.0))
    space, here = phase.mode.state, phase.states[k]
    return PlanStage(
        mode=phase.mode, x=space.np_plus(here, share * space.np_minus(phase.states[k + 1], here)),
        u=phase.controls[k], feedback=phase.feedback[k], Q_u=phase.Q_u[k], Q_ux=phase.Q_ux[k], Q_uu=phase.Q_uu[k],
        p=phase.p[k], g_mask=phase.g_mask[k], h_mask=phase.h_mask[k],
    )  # fmt: skip


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
