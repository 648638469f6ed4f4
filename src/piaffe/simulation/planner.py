"""Who plans and who controls online: interfaces of a planner and of a low level."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Planner(Protocol):
    """A planner, which makes a plan every ``period`` seconds. State comes before time.

    These are optional: ``command(**values)`` takes a :class:`Command`; ``velocity(t)`` returns the commanded velocity
    ahead and to the left [m/s] and yaw rate [rad/s] at a time, with which figures compare;
    ``running(low, thread=..., latency=...)`` returns a :class:`LoopLike`, which makes plans and ticks if planner and
    low level have a ``backend`` that is ``"native"``.
    A plan may have ``iterations`` and ``status``, and what :func:`planned_contacts` reads; ``start``, the time from
    which it acts, if that is later than the latency after its state [s]; and ``motion`` and ``request``, the name of
    its motion and of the one that is asked for.
    """

    @property
    def period(self) -> float:
        """Time between plans [s]."""
        ...

    def reset(self) -> None:
        """Delete the last plan."""
        ...

    def plan(self, x: Array, t: float) -> Any:
        """Return a plan for the low level, from a state (nx,) that was measured at time t [s].

        The planner itself predicts the state at the time at which the plan acts.
        """
        ...


class LoopLike(Protocol):
    """A planner and a low level that run together, such as ``solvers.Loop``; a context starts and stops it."""

    @property
    def asked(self) -> int:
        """Number of plans that were due."""
        ...

    @property
    def missed(self) -> int:
        """Number of plans among them that were late or not made."""
        ...

    @property
    def taken(self) -> int:
        """Number of plans that have acted."""
        ...

    @property
    def acting(self) -> Any:
        """The plan that acts: ``measured_at`` [s], ``seconds``, ``iterations``, ``status``."""
        ...

    @property
    def planning_seconds(self) -> float:
        """Time of the processor for plans that were made within the last tick [s]."""
        ...

    def begin(self, x: Array, t: float) -> None:
        """Make a plan of a state (nx,) at time t [s] now, and follow it."""
        ...

    def control(self, x: Array, t: float) -> Array:
        """Return the torques of a state (nx,) at time t [s], (nu,) [Nm]."""
        ...

    def __enter__(self) -> LoopLike: ...

    def __exit__(self, *_: Any) -> None: ...


class LowLevelLike(Protocol):
    """A low level, such as those of ``piaffe.solvers``.

    If it has ``last.iterations``, ``fallbacks``, ``relaxed`` and ``damped``, an episode records them. If
    ``measures_contacts`` is true, ``control`` gets the feet that are on the ground by their force as a third argument,
    1 or 0, (nf,).
    """

    def control(self, x: Array, t: float) -> Array:
        """Return the torques of a state (nx,) at time t [s], (nu,) [Nm]."""
        ...

    def follow(self, plan: Any) -> None:
        """Follow another plan from now on."""
        ...
