"""Pushes at work: what acts at which step of a simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from piaffe.models import base
from piaffe.ocp import Manifold, rotation

from .numbers import whole_steps
from .push import Push
from .simulation import Simulation


class Pushes:
    """Pushes at the steps of a simulation.

    Args:
        pushes: the pushes.
        space: state space of the plant.
        start: time of the first step [s].
        timestep: of the simulator [s].

    Raises:
        ModelError: a push begins before the start, or time or duration is no multiple of the time step.
    """

    def __init__(self, pushes: Sequence[Push], space: Manifold, start: float, timestep: float) -> None:
        self._where, self._pulls = space.slices[base.orientation], False
        self._times = []
        for push in pushes:
            first = whole_steps("push", f"time after the start at {start:g} s", push.time - start, timestep)
            self._times.append((first, whole_steps("push", "duration", push.duration, timestep, least=1), push))

    def apply(self, simulation: Simulation, step: int) -> None:
        """Let the pushes of a step act."""
        active = [(count, push) for first, count, push in self._times if first <= step < first + count]
        if not (active or self._pulls):
            return
        to_world = rotation.np_matrix(simulation.state[self._where][None])[0]
        force = np.zeros(3)
        for count, push in active:
            if push.force is None:
                simulation.change_velocity(push.in_world(to_world) / count)
            else:
                force += push.in_world(to_world)
        simulation.pull(force)
        self._pulls = bool(force.any())
