"""What an episode asks of a controller, whatever its method.

A controller plans every ``dt`` seconds. Without a low level, the plan's action is held until the next plan. With one
(:class:`TickingController`), ``tick`` gives the control between plans, every ``tick_dt`` seconds.
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
    """What a controller planned."""

    @property
    def action(self) -> Array:
        """Control from now on (nu,), in the plant's units: joint targets [rad] or torques [Nm]."""
        ...

    @property
    def seconds(self) -> Mapping[str, float]:
        """Time that each part of the plan took [s]."""
        ...

    @property
    def figures(self) -> Mapping[str, float]:
        """What else the method says of the plan, by name, as ``{"effective_samples": 23.5}``."""
        ...


@dataclass(frozen=True)
class Judgement:
    """What states and controls cost, T of them.

    Args:
        cost: running cost (T,).
        reward: of the cost (T,).
        violation: of the rows of constraints (nc, T), divided by each row's scale.
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
        """What it controls, as it knows it; the plant may differ."""
        ...

    @property
    def initial(self) -> Array:
        """Initial state of the declared problem (nx,)."""
        ...

    def reset(self, seed: int | None = None) -> None:
        """Forget the last plan, and begin whatever is drawn anew."""
        ...

    def hold(self, x: Array) -> Array:
        """Return the control that holds the joints where they are, (nu,); it acts before the first plan does."""
        ...

    def plan(self, x: ArrayLike, t: float) -> Plan:
        """Return a plan from a state (nx,) at a time since the motion's start [s]."""
        ...

    def judge(self, states: Array, actions: Array, t: float) -> Judgement:
        """Return what happened in the declared terms.

        Args:
            states: (T, nx), ``dt`` apart.
            actions: (T, nu).
            t: time of the first [s].
        """
        ...

    def place(self, t: float) -> Array:
        """Return where the reference wants the base at a time [s], x and y, (2,) [m]."""
        ...


@runtime_checkable
class TickingController(Controller, Protocol):
    """A controller with a low level, which acts between plans."""

    @property
    def tick_dt(self) -> float:
        """Time between ticks [s]; a plan's time is a whole number of them."""
        ...

    def tick(self, x: Array, t: float) -> Array:
        """Return the control from now on (nu,), by the last plan."""
        ...
