"""Why a solve ended: an enumeration whose values are sentences with advice."""

from enum import Enum


class Status(Enum):
    """The reason why a solve ended."""

    CONVERGED = "Converged: the iterate is stationary and every tolerance is met."
    STATIONARY = (
        "Stationary: no step helps with the barrier and the multipliers of the start, which the solve kept; rows may "
        "be violated by as much as a relaxed barrier allows, see explain()."
    )
    ITERATION_LIMIT = (
        "Stopped at the iteration limit before every tolerance was met; raise max_iterations, or see explain() for the "
        "rows that are still violated."
    )
    TIME_LIMIT = (
        "Stopped at the time limit before every tolerance was met; raise time_limit_s or warm-start from this result."
    )
    LINE_SEARCH_FAILED = (
        "No step decreased the merit even with the largest regularisation; the declared limits may exclude each other, "
        "or a term is not smooth here: see explain(), and run the derivative check."
    )
    UNSTABLE = (
        "The value function grows beyond bounds, and no step helped: the controls do not stop deviations in the phase "
        "that explain() names; start from other controls, warm-start from a solution, or shorten the horizon."
    )
    INFEASIBLE = (
        "A constraint stays violated although penalties grew, and no step reduces the violation; the rows that "
        "explain() names cannot all hold: relax them, lengthen the phase or move the keyframe."
    )
    NOT_FINITE = (
        "A value or derivative is NaN or infinite, at the start or at every trial step; check the function that "
        "explain() names: bound its arguments, or start from another iterate."
    )
    INTERRUPTED = "Interrupted by the user; the best iterate so far is returned."

    @property
    def advice(self) -> str:
        """The sentence."""
        return str(self.value)
