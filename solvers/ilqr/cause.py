"""The cause of a status: a number that is not finite, or a value function that grows beyond bounds."""

from __future__ import annotations

from ..solution import Status
from .fault import fault
from .growth import growth
from .iterate import Iterate, ProblemFunctions
from .outer import Outer


def with_cause(
    status: Status, functions: ProblemFunctions, iterate: Iterate, outer: Outer, outside: Iterate | None
) -> tuple[Status, str]:
    """Return a solve's status and a sentence about its cause, if there is one.

    A failed line search whose value function grows beyond bounds has the status ``UNSTABLE``.

    Args:
        status: the status with which the iterations ended.
        functions: the problem's functions.
        iterate: the last iterate.
        outer: its barrier and multipliers.
        outside: the last trial step whose merit was not finite, if there was one.
    """
    if status is Status.NOT_FINITE:
        return status, fault(functions, iterate, outside)
    found = growth(functions, iterate, outer) if status is Status.LINE_SEARCH_FAILED else ""
    return (Status.UNSTABLE, found) if found else (status, "")
