"""Contact points that cannot be held independently: their forces are not determined by the rigid contact dynamics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError

from .robot import Robot

Array = NDArray[np.float64]


def refuse_redundant_contacts(robot: Robot, jacobians: Sequence[Array]) -> None:
    """Raise ModelError if the contact points of some feet are redundant in every posture.

    Args:
        robot: the robot.
        jacobians: J of all contact points in some postures, (3 nf, nv) each.
    """
    kept: list[int] = []
    redundant = []
    for i, foot in enumerate(robot.feet):
        rows = [3 * k + axis for k in (*kept, i) for axis in range(3)]
        if max(np.linalg.matrix_rank(J[rows], tol=1e-6) for J in jacobians) == len(rows):
            kept.append(i)
        else:
            redundant.append(foot.name)
    if redundant:
        independent = ", ".join(robot.feet[i].name for i in kept)
        raise ModelError(
            f"whole body of '{robot.name}': redundant contact points - got {', '.join(redundant)} beside "
            f"{independent}, expected points that can be held independently; remove some, or set contact_damping "
            "(for example 1e-6 / kg)"
        )
