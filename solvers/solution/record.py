"""Records: one line of a solve's history."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Record:
    """One iteration, for the live table and for the history of a solution.

    Args:
        iteration: from 1.
        cost: declared cost.
        merit: cost, barrier, augmented Lagrangian and weighted defects.
        expected: decrease of the merit's smooth part that the model predicts for a full step.
        max_defect: ∞-norm in the tangent, in natural sizes of the model.
        max_equality: largest equality violation.
        max_inequality: largest inequality violation.
        step_size: accepted step, 0 if none.
        regularization: Levenberg regularisation of the next iteration.
        barrier_weight: ε.
        wall_s: seconds since the start.
    """

    iteration: int
    cost: float
    merit: float
    expected: float
    max_defect: float
    max_equality: float
    max_inequality: float
    step_size: float
    regularization: float
    barrier_weight: float
    wall_s: float
