"""Between two solves: barrier, multipliers and penalties of the next one, if solves do not change them themselves."""

from __future__ import annotations

from ..solution import Status
from .run import Run


def adapt_for_next(run: Run, status: Status, largest_defect: float) -> None:
    """Set the parameters of the next solve, after one that did not adapt, as between two sub-problems.

    Nothing is due if the solve has failed, made no step, left a defect of this size, or met everything.

    Args:
        run: the solve, whose ``outer`` has the parameters.
        status: reason why it ended.
        largest_defect: largest defect, ∞-norm in the tangent, after which an unsolved sub-problem is left.
    """
    at, outer = run.current, run.outer
    stationary = status is Status.STATIONARY
    if not stationary:
        moved = status in (Status.ITERATION_LIMIT, Status.TIME_LIMIT) and bool(run.history)
        if not moved or at.max_defect >= largest_defect:
            return
        if run.keeps_tolerances() and outer.near_gap(at.values) <= outer.allowed(at.cost):
            return
    outer.update(at.values, at.cost, run.violations(at), stationary=stationary)
