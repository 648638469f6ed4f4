"""Constants of the algorithm: the numbers beside the options, in one place for both backends.

NumPy's solver reads them here by name; the compiled solver gets a ``#define`` of each, under the same name. A change
here changes both, and the compiled solver is built anew.
"""

from __future__ import annotations

# ---- the scale of the cost

SCALE_PENALTY = 10.0
"""Penalty of equalities and violated inequalities in that model, relative to the cost of residuals that are all 1."""
SCALE_RELAXATION = 0.01
"""Relaxation of the barrier in that model, in units of a row's scale."""
SCALE_RIDGE = 1e-9
"""Regularisation of that model, relative to the cost of residuals that are all 1."""

# ---- when a sub-problem is solved

PATIENCE = 8
"""Steps in a row that gain less than the tolerance, after which a sub-problem counts as solved."""
NEARLY_CLOSED = 0.05
"""A sub-problem may be left unsolved if its largest defect is below this."""

# ---- regularisation

REGULARIZATION_FACTOR = 4.0
"""The regularisation is multiplied by this to raise it, divided by it to lower it."""
RAISES_AFTER_FAILURE = 2
"""How often it is raised after a line search without an accepted step."""
LONG_STEP = 0.4
"""It is lowered after steps longer than this."""
SHORT_STEP = 0.01
"""It is raised after steps shorter than this; after longer ones that still gain, it would only make them shorter."""
POLICY_REGULARIZATION_FACTOR = 10.0
"""Ratio of the regularisations that are tried for the policy of a result."""

# ---- the weight ρ of the defects in the merit

SMALLEST_GAP = 1e-12
"""ρ is not adapted to defects whose sum is below this."""
RHO_DECAY = 0.98
"""Smallest ratio of ρ to that of the iteration before."""
LONG_SUBPROBLEM = 4.0
"""A sub-problem with more iterations than this times ``max_inner`` raises the least ρ."""
LEAST_RHO_FACTOR = 2.0
"""The least ρ is multiplied by this then, once in ``max_inner`` iterations."""

# ---- line search

STEPS_BACK = 3
"""The first trial step is the last accepted one divided by this power of ``step_shrink``, 1 at most."""
MERIT_ROUNDING = 1e-12
"""Increase of the merit, relative to its value, that passes as rounding."""
GAP_DECREASE = 0.9
"""A trial step α is corrected if it leaves more than 1 − this · α of the defects."""
SAME_MERIT = 1e-9
"""Two merits are of the same iterate of the same problem if they differ by this at most, relative to the merit."""

# ---- barrier

NEARLY_MET = 10.0
"""ε shrinks after a solved sub-problem if no violation is larger than this times ``max_inequality``."""
NEAR_BOUND = 10.0
"""A row is near its bound if it is below this times the first ``relaxation``."""
SLACK = 0.25
"""A row is pushed harder if its violation is larger than this times ``max_inequality``."""
AT_FLOOR = 1.01
"""A relaxation is the smallest one if it is below this times the floor."""
LARGEST_SHRINK = 3.0
"""A shrink divides a relaxation by this at most."""
LEAST_SHRINK = 0.7
"""A shrink multiplies a relaxation by this at least."""

# ---- equalities, and problems without a solution

SLOW_DECREASE = 0.25
"""Penalties grow if the equality violation is larger than this times that of the update before."""
NO_PROGRESS = 0.98
"""A sub-problem has not reduced the violation if more than this times the violation before remains."""
MAX_UNMOVED = 8
"""Sub-problems in a row that have not reduced it, each with larger penalties. After more of them, steps that hardly
regard the cost are tried; if they do not reduce it either, the problem counts as infeasible."""
SHARE_OF_COST = 1e-6
"""Share of the cost in the model of these steps."""
SHORTEST_ATTEMPT = 0.01
"""None of them is shorter than this; they become shorter by ``step_shrink``."""
IMPROVED = 0.95
"""Such a step reduces the violation if less than this times the violation remains."""


def table() -> dict[str, int | float]:
    """Return all constants by name."""
    return {name: value for name, value in globals().items() if name.isupper()}
