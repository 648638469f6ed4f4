"""Parts of a solution: what each phase holds beside its trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PhaseSolution:
    """What one phase's solution holds beside its trajectory, for N stages.

    The policy is u = ū + α k + K (x ⊖ x̄); at the solution α k is what a further iteration would add. Expansions are in
    δx and δu about the trajectory, barrier and augmented Lagrangian included.

    Args:
        feedforward: k (N, nu). feedback: K (N, nu, ndx).
        V_x, V_xx: value function at nodes 0..N. Q_x, Q_u, Q_xx, Q_ux, Q_uu: action-value function at stages.
        defects: (N+1, ndx); row 0 is the initial state's or the reset map's.
        multipliers: ``equality`` (N, nh), ``end_equality`` (nh_end,), ``inequality`` (N, ng), ``end_inequality``; of
            rates for stages. ``penalty``, ``relaxation``, ``shift`` and ``end_`` twins: what a warm start resumes.
        target_states: the path the motion was asked to follow (N+1, nx).
    """

    feedforward: Array
    feedback: Array
    V_x: Array
    V_xx: Array
    Q_x: Array
    Q_u: Array
    Q_xx: Array
    Q_ux: Array
    Q_uu: Array
    defects: Array
    multipliers: Mapping[str, Array]
    target_states: Array
