"""Contacts of MuJoCo: forces on the feet, their slip, and what else touches the ground."""

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


def foot_slip(model: Any, data: Any, feet: Sequence[int]) -> Array:
    """Return the speed of each foot's material point of contact along the ground, (nf,) [m/s]; 0 without contact.

    A ball that rolls does not slip. Of several contacts of a foot, the fastest counts.

    Args:
        model: a ``mujoco.MjModel``.
        data: its ``mujoco.MjData``, after a step or ``mj_forward``.
        feet: ids of the feet's geoms.
    """
    mujoco = import_mujoco()
    speeds: Array = np.zeros(len(feet))
    velocity = np.zeros(6)  # angular, linear, in world axes at the geom's centre
    for c in range(data.ncon):
        contact = data.contact[c]
        for side in (contact.geom1, contact.geom2):
            if side in feet:
                mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, side, velocity, 0)
                at_point = velocity[3:] + _cross(velocity[:3], contact.pos - data.geom_xpos[side])
                normal = contact.frame[:3]
                along = float(np.linalg.norm(at_point - normal * (normal @ at_point)))
                i = feet.index(side)
                speeds[i] = max(speeds[i], along)
    return speeds


def others_in_contact(model: Any, data: Any, feet: Sequence[int]) -> tuple[str, ...]:
    """Return the names of the robot's geoms that touch the ground and are no feet; of their bodies if they have none.

    Args:
        model: a ``mujoco.MjModel``.
        data: its ``mujoco.MjData``, after a step or ``mj_forward``.
        feet: ids of the feet's geoms.
    """
    if not (data.ncon and feet):
        return ()
    sides = data.contact.geom
    bodies = model.geom_bodyid[sides]
    fixed = model.body_weldid[bodies] == 0
    own = model.body_rootid[bodies] == model.body_rootid[model.geom_bodyid[feet[0]]]
    touching = set(sides[fixed[:, ::-1] & own].tolist()) - set(feet)
    return tuple(model.geom(side).name or model.body(model.geom_bodyid[side]).name for side in sorted(touching))


def _cross(a: Array, b: Array) -> Array:
    """Return a × b of two vectors (3,); ``np.cross`` takes ten times as long."""
    (a1, a2, a3), (b1, b2, b3) = a.tolist(), b.tolist()
    return np.array((a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1))
