"""One loop for all episodes: plans at one rate, controls at a faster one, the simulator at the fastest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .simulation import Simulation

Array = NDArray[np.float64]


class Acts(Protocol):
    """What happens in a loop: who plans, who controls, what is recorded."""

    @property
    def done(self) -> bool:
        """Whether the loop ends now."""
        ...

    def measure(self, t: float) -> Array:
        """Return the state from which a plan is made at time t [s], (nx,)."""
        ...

    def plan(self, x: Array, t: float) -> None:
        """Make the plan of a state (nx,) that was measured at time t [s]; it acts from now on."""
        ...

    def control(self, t: float, due: bool) -> Array:
        """Return the control of the step that starts at time t [s], (nu,).

        Args:
            t: the time [s].
            due: whether the low level acts at this step.
        """
        ...


@dataclass(frozen=True)
class Rates:
    """Rates of a loop, in steps of the simulator.

    Args:
        plan: between plans.
        tick: between controls, a divisor of ``plan``; 0 if the low level acts only when a plan begins to act.
        lag: from a measurement to the first effect of its plan, at most ``plan``.
    """

    plan: int
    tick: int
    lag: int


class TwoRates:
    """The steps of a simulation under two rates.

    A plan is made from the state at the start of a period, and acts ``lag`` steps later; until then the plan before
    acts. The low level acts every ``tick`` steps, and when a plan begins to act.

    Args:
        simulation: the robot.
        acts: what happens.
        rates: how often.
        limit: largest number of steps of the simulator; none by default.
    """

    def __init__(self, simulation: Simulation, acts: Acts, rates: Rates, limit: int | None = None) -> None:
        self._simulation, self._acts, self._rates, self._limit = simulation, acts, rates, limit
        self._timestep, self.steps = simulation.timestep, 0

    @property
    def over(self) -> bool:
        """Whether the loop ends before its next step."""
        return self._acts.done or self.steps == self._limit

    def period(self, t: float) -> None:
        """Simulate the period of a plan that starts at time t [s]."""
        measured = self._acts.measure(t)
        self._advance(t, 0, self._rates.lag)
        if self.over:
            return
        self._acts.plan(measured, t)
        self._advance(t, self._rates.lag, self._rates.plan)

    def _advance(self, t: float, first: int, last: int) -> None:
        tick, lag = self._rates.tick, self._rates.lag
        for i in range(first, last):
            if self.over:
                return
            control = self._acts.control(t + i * self._timestep, i == lag or (tick > 0 and i % tick == 0))
            if self._acts.done:
                return
            self._simulation.step(control)
            self.steps += 1
