"""Time: when two times are the same."""

SAME_TIME = 1e-7
"""Times that differ by less are one [s].

Larger than what rounding adds up to over many phases, and than what a user's seven digits leave out; far smaller than a
time step.
"""


def is_same_time(a: float, b: float) -> bool:
    """Return whether two times, or two durations, are the same [s]."""
    return abs(a - b) < SAME_TIME
