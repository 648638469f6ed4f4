"""The hybrid roll-out: shooting nodes move along the linear step, the others follow the nonlinear dynamics.

A node is a shooting node if its state is a decision of its own, whose defect the solver closes; otherwise its state is
what the dynamics (or the reset map) makes of the node before, and its defect is zero at every iterate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .iterate import Evaluator, Iterate

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


def move(
    evaluator: Evaluator,
    start: Iterate,
    dx: list[Array],
    du: list[Array],
    size: float,
    shooting: list[Flags],
    feedback: list[Array] | None = None,
) -> Iterate:
    """Return the iterate a step away from ``start``.

    Shooting nodes: x = x̄ ⊕ α δx. Everywhere u = ū + α δu + K [(x ⊖ x̄) − α δx], which at shooting nodes is the linear
    step itself and elsewhere lets the policy act on where the roll-out really is.

    Args:
        evaluator: the problem's functions.
        start: x̄, ū.
        dx: full step of the states, per phase (N+1, ndx).
        du: full step of the controls, per phase (N, nu).
        size: α.
        shooting: which nodes are shooting nodes, per phase (N+1,).
        feedback: K per phase (N, nu, ndx); None for no feedback.
    """
    states: list[Array] = []
    controls: list[Array] = []
    for i, phase in enumerate(evaluator.problem.phases):
        space = phase.mode.state
        x = space.np_plus(start.states[i], size * dx[i])
        u = start.controls[i] + size * du[i]
        if not shooting[i].all():
            if not shooting[i][0]:
                x[0] = evaluator.problem.initial if i == 0 else evaluator.reset(i - 1, states[-1][-1])
            for k in range(phase.num_stages):
                if feedback is not None:
                    u[k] += feedback[i][k] @ (space.np_minus(x[k], start.states[i][k]) - size * dx[i][k])
                if not shooting[i][k + 1]:
                    x[k + 1] = evaluator.step(i, k, x[k], u[k])
        states.append(x)
        controls.append(u)
    return Iterate(states, controls)
