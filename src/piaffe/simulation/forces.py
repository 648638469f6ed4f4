"""Contact forces of MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.models import import_mujoco

Array = NDArray[np.float64]


def foot_forces(model: Any, data: Any, feet: Sequence[int]) -> Array:
    """Return the world force on each foot, (nf, 3) [N].

    Args:
        model: a ``mujoco.MjModel``.
        data: its ``mujoco.MjData``, after a step or ``mj_forward``.
        feet: ids of the feet's geoms.
    """
    mujoco = import_mujoco()
    total: Array = np.zeros((len(feet), 3))
    wrench = np.zeros(6)
    for c in range(data.ncon):
        contact = data.contact[c]
        for side, sign in ((contact.geom1, -1.0), (contact.geom2, 1.0)):
            if side in feet:
                mujoco.mj_contactForce(model, data, c, wrench)
                total[feet.index(side)] += sign * contact.frame.reshape(3, 3).T @ wrench[:3]
    return total
