"""Time: when two times are the same."""

SAME_TIME = 1e-7
"""Times that differ by less than this are the same [s].

It is larger than the sum of rounding errors over many phases, and than the error of a number with seven digits. It is
much smaller than a time step.
"""


def is_same_time(a: float, b: float) -> bool:
    """Return whether two times, or two durations, are the same [s]."""
    return abs(a - b) < SAME_TIME
