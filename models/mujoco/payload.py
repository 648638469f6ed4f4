"""A payload: a mass fixed to the base of a simulated robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio

from piaffe.errors import ModelError

from ..robot import ROOT, Robot


@dataclass(frozen=True)
class Payload:
    """A point mass on the base; made by :func:`payload`.

    Args:
        mass: [kg].
        offset: its position in the base's axes [m].
    """

    mass: float
    offset: tuple[float, float, float]

    def put_on(self, robot: Robot) -> Robot:
        """Return the robot with the payload added to the inertia of its base link."""
        model = robot.model.copy()
        model.inertias[ROOT] += pinocchio.Inertia(self.mass, np.array(self.offset), np.zeros((3, 3)))
        return replace(robot, model=model)


def payload(mass: float, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Payload:
    """Return a point mass for a robot's base.

    Args:
        mass: [kg].
        offset: its position in the base's axes [m].

    Raises:
        ModelError: a number is out of range.
    """
    place = np.asarray(offset, dtype=float)
    if not (np.isfinite(mass) and mass >= 0):
        raise ModelError(f"payload: mass is out of range - got {mass!r}, expected a number ≥ 0 [kg]; give one")
    if place.shape != (3,) or not np.all(np.isfinite(place)):
        raise ModelError(f"payload: offset is not a position - got {offset!r}, expected x, y, z [m]; give three")
    return Payload(float(mass), (float(place[0]), float(place[1]), float(place[2])))
