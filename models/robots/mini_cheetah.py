"""Mini Cheetah (MIT), 12 joints, 8.252 kg.

Sources: ``urdf/mini_cheetah.urdf`` holds masses, inertias, geometry and limits as CAFE-MPC publishes them. The rotors,
which that model leaves out, are those of Cheetah-Software. ``tuck`` and ``lean`` are poses of CAFE-MPC's barrel roll.
"""

from __future__ import annotations

from math import pi

import numpy as np
import pinocchio
from numpy.typing import NDArray

from ..robot import ROOT
from .known import KnownRobot

Array = NDArray[np.float64]

_LEGS = ("FL", "FR", "HL", "HR")
_ROTOR_KG, _SPIN, _ACROSS = 0.055, 63e-6, 33e-6  # mass; inertia about the spin axis and across it [kg m²]
_GEAR_RATIOS = (6.0, 6.0, 9.33)


def add_rotors(model: pinocchio.Model) -> Array:
    """Add 12 rotors of 55 g to the links that carry them, and return their reflected inertia, (12,) [kg m²]."""
    about_x, about_y = np.diag([_SPIN, _ACROSS, _ACROSS]), np.diag([_ACROSS, _SPIN, _ACROSS])
    for leg in _LEGS:
        front, side = (1 if leg[0] == "F" else -1), (1 if leg[1] == "L" else -1)
        places = (
            (ROOT, (0.125 * front, 0.049 * side, 0.0), about_x),
            (model.getJointId(f"{leg}_HAA"), (0.0, 0.04 * side, 0.0), about_y),
            (model.getJointId(f"{leg}_HFE"), (0.0, 0.0, 0.0), about_y),
        )
        for joint, place, inertia in places:
            model.inertias[joint] += pinocchio.Inertia(_ROTOR_KG, np.array(place), inertia)
    return np.tile(_SPIN * np.array(_GEAR_RATIOS) ** 2, 4)


ROBOT = KnownRobot(
    urdf="urdf/mini_cheetah.urdf",
    legs=_LEGS,
    foot_frame="{}_FOOT",
    foot_radius=0.0175,
    poses={
        "stand": ((0.0, -1.0, 2.0),),
        "crouch": ((0.0, -1.2, 2.4),),
        "tuck": ((0.3, -1.1, 2.2), (-0.3, -1.1, 2.2)) * 2,
        "lean": ((pi / 6, -1.0, 2.0), (-pi / 5, -0.5, 1.0)) * 2,
    },
    add_rotors=add_rotors,
)
"""Mini Cheetah; its URDF lies in this package."""
