"""Bounds over a phase: functions of the time since the start of a phase, whose values are numbers at each node."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import PiaffeError, ProblemError, ShapeError

from .source import caller
from .user_input import brief, failed, numbers_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PhaseTime:
    """A time within a phase of a motion.

    Args:
        t: time since the start of the phase, from 0 to its duration [s].
        duration: length of the phase [s].
        phase: name of the phase.
        model: the model of the node, for limits of its robot: ``at.model.robot.torque_limit``.
    """

    t: float
    duration: float
    phase: str
    model: Any

    @property
    def share(self) -> float:
        """The share of the phase that is over, from 0 to 1."""
        return self.t / self.duration

    def __str__(self) -> str:
        return f"phase '{self.phase}', {self.t:.6g} s after its start"


@dataclass(frozen=True)
class OverPhase:
    """A bound that is a function of the time within a phase, see :func:`over_phase`."""

    function: Callable[[PhaseTime], Any]

    def __call__(self, at: PhaseTime) -> Any:
        """Return the bound at a time."""
        return self.function(at)

    def values(self, at: PhaseTime, size: int, where: str, what: str, unit: str) -> Array:
        """Return the bounds of rows at a time, (size,).

        Args:
            at: the time.
            size: number of rows.
            where: the declaration, for messages.
            what: which bound, for messages.
            unit: unit of the rows, for messages.

        Raises:
            ProblemError: the function fails, or its result is neither a number nor an array of numbers.
            ShapeError: the result has another size, or NaN in it.
        """
        place = f"{where}, {at}"
        try:
            result = self.function(at)
        except PiaffeError:
            raise
        except Exception as error:
            raise failed(error, f"{place}: {what}", "numbers; fix it") from error
        numbers = numbers_of(result, place, what)
        if numbers.ndim > 1 or numbers.size not in (1, size) or np.any(np.isnan(numbers)):
            raise ShapeError(
                f"{place}: {what} is unusable - got {numbers.tolist()}, expected 1 or {size} numbers [{unit or '-'}]; "
                "return one per row or a scalar"
            )
        return np.broadcast_to(numbers, (size,)).astype(float)


def over_phase(function: Callable[[PhaseTime], Any]) -> OverPhase:
    """Return a bound that is a function of the time within a phase.

    ``upper=ocp.over_phase(lambda at: 0.4 - 0.1 * at.share)`` falls from 0.4 to 0.3 in each phase. The function is
    called for each node, and its values are numbers, as those of constant bounds: derivatives and compiled code are the
    same. A bound may be infinite at some times: the rows then do not apply there.

    Args:
        function: function of a :class:`PhaseTime` that returns a number, or one per row.

    Raises:
        ProblemError: it is not a function.
    """
    if not callable(function):
        raise ProblemError(
            f"over_phase ({caller()}): is not a function - got {brief(function)}, expected a function of the time "
            "within a phase, such as lambda at: 0.1 * at.share; give one, or give the number itself as the bound"
        )
    return OverPhase(function)
