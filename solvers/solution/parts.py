"""Parts of a solution: the results of each phase in addition to its trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PhaseSolution:
    """The results of one phase with N stages, in addition to its trajectory.

    The policy is u = ū + α k + K (x ⊖ x̄). At the solution, α k is the change of ū in a further iteration. Expansions
    are in δx and δu about the trajectory, barrier and augmented Lagrangian included.

    Args:
        feedforward: k (N, nu). feedback: K (N, nu, ndx).
        V_x, V_xx: value function at nodes 0..N. Q_x, Q_u, Q_xx, Q_ux, Q_uu: action-value function at stages.
        defects: (N+1, ndx); row 0 is the defect of the initial state or of the reset map.
        multipliers: ``equality`` (N, nh), ``end_equality`` (nh_end,), ``inequality`` (N, ng), ``end_inequality``; those
            of stages are rates. A warm start also uses ``penalty``, ``relaxation``, ``shift``, and the same three with
            ``end_``.
        target_states: states of the target path (N+1, nx).
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
