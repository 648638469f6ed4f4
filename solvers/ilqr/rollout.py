"""The hybrid roll-out: shooting nodes take the linear step, the other nodes follow the nonlinear dynamics.

The state of a shooting node is a decision variable, and the solver closes its defect. The state of another node is the
result of the dynamics (or of the reset map) at the node before, so its defect is zero at every iterate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .iterate import Iterate, ProblemFunctions

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


def move(
    functions: ProblemFunctions,
    start: Iterate,
    dx: list[Array],
    du: list[Array],
    size: float,
    shooting: list[Flags],
    feedback: list[Array] | None = None,
) -> Iterate:
    """Return the iterate after a step from ``start``.

    At shooting nodes x = x̄ ⊕ α δx. At all nodes u = ū + α δu + K [(x ⊖ x̄) − α δx]: at shooting nodes this is the
    linear step, at the others the feedback acts on the state of the nonlinear roll-out.

    Args:
        functions: the problem's functions.
        start: x̄, ū.
        dx: full step of the states, per phase (N+1, ndx).
        du: full step of the controls, per phase (N, nu).
        size: α.
        shooting: which nodes are shooting nodes, per phase (N+1,).
        feedback: K per phase (N, nu, ndx); None for no feedback.
    """
    states: list[Array] = []
    controls: list[Array] = []
    for i, phase in enumerate(functions.problem.phases):
        space = phase.mode.state
        x = space.np_plus(start.states[i], size * dx[i])
        u = start.controls[i] + size * du[i]
        if not shooting[i].all():
            if not shooting[i][0]:
                x[0] = functions.problem.initial if i == 0 else functions.reset(i - 1, states[-1][-1])
            for k in range(phase.num_stages):
                if feedback is not None:
                    u[k] += feedback[i][k] @ (space.np_minus(x[k], start.states[i][k]) - size * dx[i][k])
                if not shooting[i][k + 1]:
                    x[k + 1] = functions.step(i, k, x[k], u[k])
        states.append(x)
        controls.append(u)
    return Iterate(states, controls)
