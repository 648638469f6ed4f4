"""Other masses, a payload, and other numbers of joints in a compiled MuJoCo model."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError, UnknownNameError
from piaffe.models import Payload, import_mujoco

from .actuators import Actuators
from .numbers import finite_number
from .scene import Scene, allow

Array = NDArray[np.float64]

_FIELDS = {"armature": "dof_armature", "damping": "dof_damping", "friction": "dof_frictionloss"}
_EFFECTS: dict[str, tuple[str, ...]] = {
    "armature": (),
    "damping": ("DAMPER", "EULERDAMP"),
    "friction": ("FRICTIONLOSS",),
}


def scale_masses(scene: Scene, scale: float | Mapping[str, float]) -> None:
    """Multiply masses and inertias of the robot's bodies by a factor, or by one for each named body.

    Raises:
        ModelError: a factor is not positive.
        UnknownNameError: there is no such body.
    """
    model = scene.compiled
    bodies = named_bodies(scene)
    factors = scale if isinstance(scale, Mapping) else dict.fromkeys(bodies, scale)
    for name, factor in factors.items():
        if name not in bodies:
            raise UnknownNameError(f"plant of '{scene.robot.name}', mass_scale", "body", name, bodies)
        if finite_number("plant", "mass_scale", factor) <= 0:
            raise ModelError(
                f"plant of '{scene.robot.name}': mass_scale is out of range - got {factor!r}, expected a factor > 0; "
                "change it"
            )
        model.body_mass[bodies[name]] *= factor
        model.body_inertia[bodies[name]] *= factor


def named_bodies(scene: Scene) -> dict[str, int]:
    """Return the ids of the robot's bodies by name, the base first; a body without a name gets one from its id."""
    model = scene.compiled
    root = model.body_rootid[scene.base]
    own = [b for b in range(1, model.nbody) if model.body_rootid[b] == root]
    return {model.body(b).name or f"body {b}": b for b in sorted(own, key=lambda b: b != scene.base)}


def add_payload(scene: Scene, payload: Payload) -> None:
    """Add a point mass to the base's body.

    With masses m₁, m₂ at c₁, c₂ the joint inertia about the common centre c is::

        I = I₁ + m₁ S(c₁ − c) + m₂ S(c₂ − c),   S(d) = dᵀd 1 − d dᵀ
    """
    model, b, mujoco = scene.compiled, scene.base, import_mujoco()
    if payload.mass == 0.0:
        return
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[b])
    turn = axes.reshape(3, 3)
    first, second = float(model.body_mass[b]), payload.mass
    place, offset = np.array(model.body_ipos[b]), np.array(payload.offset)
    centre = (first * place + second * offset) / (first + second)
    inertia = turn @ np.diag(model.body_inertia[b]) @ turn.T
    inertia += first * _spread(place - centre) + second * _spread(offset - centre)
    principal, vectors = np.linalg.eigh(inertia)
    vectors = vectors * np.sign(np.linalg.det(vectors))
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, vectors.ravel())
    model.body_mass[b], model.body_ipos[b] = first + second, centre
    model.body_inertia[b], model.body_iquat[b] = principal, quaternion


def set_joints(scene: Scene, actuators: Actuators) -> None:
    """Set armature, damping and dry friction of the joints, where they are given, and switch their effect on."""
    model, joints = scene.compiled, scene.velocities[6:]
    for name, field in _FIELDS.items():
        values = actuators.number(name, scene.robot)
        if values is not None:
            getattr(model, field)[joints] = values
            allow(model, *_EFFECTS[name])


def finish(scene: Scene) -> None:
    """Compute what MuJoCo derives from masses and inertias."""
    mujoco = import_mujoco()
    mujoco.mj_setConst(scene.compiled, mujoco.MjData(scene.compiled))


def _spread(d: Array) -> Array:
    return np.asarray(d @ d * np.eye(3) - np.outer(d, d))
