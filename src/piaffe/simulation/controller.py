"""The interface of a controller in an episode.

A controller plans every ``dt`` seconds. The plan's action is held until the next plan. A :class:`TickingController` has
a low-level controller: ``tick`` returns the control between plans, every ``tick_dt`` seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.models import Mujoco

Array = NDArray[np.float64]


class Plan(Protocol):
    """The plan of a controller."""

    @property
    def action(self) -> Array:
        """Control from the plan's time on (nu,), in the plant's units: joint targets [rad] or torques [Nm]."""
        ...

    @property
    def seconds(self) -> Mapping[str, float]:
        """Time that each part of the plan took [s]."""
        ...

    @property
    def figures(self) -> Mapping[str, float]:
        """Further figures of the method about the plan, by name, as ``{"effective_samples": 23.5}``."""
        ...


@dataclass(frozen=True)
class Judgement:
    """Cost, reward and violations of T states and controls.

    Args:
        cost: running cost (T,).
        reward: reward for the cost (T,).
        violation: violations of the rows of constraints (nc, T), divided by each row's scale.
        constraints: the constraint that each row belongs to, (nc,).
    """

    cost: Array
    reward: Array
    violation: Array
    constraints: tuple[str, ...]


class Controller(Protocol):
    """A controller in closed loop. State comes before time in every call."""

    @property
    def dt(self) -> float:
        """Time between plans [s]."""
        ...

    @property
    def model(self) -> Mujoco:
        """The controller's model of the robot; the plant may differ from it."""
        ...

    @property
    def initial(self) -> Array:
        """Initial state of the declared problem (nx,)."""
        ...

    def reset(self, seed: int | None = None) -> None:
        """Delete the last plan, and restart the random numbers from a seed."""
        ...

    def hold(self, x: Array) -> Array:
        """Return the control that holds the joints at their positions, (nu,); it acts until the first plan."""
        ...

    def plan(self, x: ArrayLike, t: float) -> Plan:
        """Return a plan from a state (nx,) at a time since the motion's start [s]."""
        ...

    def judge(self, states: Array, actions: Array, t: float) -> Judgement:
        """Return cost, reward and violations of states and controls.

        Args:
            states: (T, nx), at intervals of ``dt``.
            actions: (T, nu).
            t: time of the first state [s].
        """
        ...

    def place(self, t: float) -> Array:
        """Return the target position of the base at a time [s], x and y, (2,) [m]."""
        ...


@runtime_checkable
class TickingController(Controller, Protocol):
    """A controller with a low-level controller that acts between plans."""

    @property
    def tick_dt(self) -> float:
        """Time between ticks [s]; ``dt`` is a multiple of it."""
        ...

    def tick(self, x: Array, t: float) -> Array:
        """Return the control for a state from time t [s] on, (nu,), from the last plan."""
        ...
