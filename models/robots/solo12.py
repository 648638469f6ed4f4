"""Solo12 (Open Dynamic Robot Initiative), 12 joints, 2.5 kg.

Sources: the URDF of the package example-robot-data. Its limits are placeholders (1000 Nm, 10 rad). In their place:
torque of the actuator, 0.225 Nm/A at 12 A; angles that keep the links apart; a speed that its motors hold under load.
"""

from __future__ import annotations

import numpy as np
import pinocchio
from numpy.typing import NDArray

from .known import KnownRobot

Array = NDArray[np.float64]

_SPIN, _GEAR_RATIO = 5.3e-6, 9.0  # inertia of a motor about its axis [kg m²]


def add_rotors(model: pinocchio.Model) -> Array:
    """Return the reflected inertia of the motors, (12,) [kg m²]; the links of the URDF hold their masses."""
    return np.full(model.nv - 6, _SPIN * _GEAR_RATIO**2)


ROBOT = KnownRobot(
    urdf="solo_description/robots/solo12.urdf",
    legs=("FL", "FR", "HL", "HR"),
    foot_frame="{}_FOOT",
    foot_radius=0.0165,
    poses={
        "stand": ((0.0, 0.8, -1.6), (0.0, 0.8, -1.6), (0.0, -0.8, 1.6), (0.0, -0.8, 1.6)),
        "crouch": ((0.0, 1.1, -2.2), (0.0, 1.1, -2.2), (0.0, -1.1, 2.2), (0.0, -1.1, 2.2)),
    },
    limits={"torque": (2.7, 2.7, 2.7), "angle": (1.2, 2.6, 2.9), "speed": (30.0, 30.0, 30.0)},
    add_rotors=add_rotors,
)
"""Solo12, with the limits of its actuators in place of the URDF's placeholders."""
