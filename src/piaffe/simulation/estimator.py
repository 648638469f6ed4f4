"""The interface of a state estimator in an episode."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .sensors import Reading

Array = NDArray[np.float64]


class Estimator(Protocol):
    """Estimates the state from the sensors on the robot."""

    def reset(self, x: Array) -> None:
        """Begin anew from a known state (nx,)."""
        ...

    def estimate(self, reading: Reading, elapsed: float) -> Array:
        """Return the state (nx,) of a reading.

        Args:
            reading: what the sensors measure.
            elapsed: time since the last reading [s]; 0 at the first.
        """
        ...
