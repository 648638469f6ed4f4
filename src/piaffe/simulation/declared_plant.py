"""The robot and the ground of a problem, with the problem's own numbers, for a simulator."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.models import Robot, WholeBody, terrain
from piaffe.ocp import CompiledProblem

Array = NDArray[np.float64]

_OF_JOINTS = ("armature", "joint_damping", "joint_friction")


def declared_robot(compiled: CompiledProblem) -> Robot:
    """Return the robot with gravity, links, rotors and losses of joints as the problem gives its model at the start.

    Raises:
        ModelError: the problem does not begin with a whole body.
    """
    model: Any = compiled.phases[0].mode.model
    if not isinstance(model, WholeBody):
        raise ModelError(
            f"execution: the problem does not begin with a whole body - got model '{model.name}', expected a "
            "models.WholeBody; only torques can be played"
        )
    robot: Robot = model.robot
    numbers = {name: _number(compiled, name) for name in ("gravity", "foot_radius", *_OF_JOINTS)}
    changed = robot.model.copy()
    changed.gravity = pin.Motion(numbers["gravity"], np.zeros(3))
    mass, com, inertia = (
        _number(compiled, f"link_{name}").reshape(model.tree.num_links, -1) for name in ("mass", "com", "inertia")
    )
    for i, (m, c, (xx, yy, zz, xy, xz, yz)) in enumerate(zip(mass[:, 0], com, inertia, strict=True), start=1):
        changed.inertias[i] = pin.Inertia(float(m), c, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    of_joints: dict[str, Any] = {name: numbers[name] for name in _OF_JOINTS}
    return replace(robot, model=changed, foot_radius=float(numbers["foot_radius"][0]), **of_joints)


def declared_ground(compiled: CompiledProblem) -> terrain.Terrain:
    """Return the ground of the problem's model; level ground has the height that the problem gives it at the start."""
    model: Any = compiled.phases[0].mode.model
    if not isinstance(model.terrain, terrain.Flat):
        own: terrain.Terrain = model.terrain
        return own
    return terrain.flat(float(_number(compiled, "terrain")[0]))


def _number(compiled: CompiledProblem, slot: str) -> Array:
    """Return the value of a slot of the first phase's model at the start."""
    phase = compiled.phases[0]
    if slot in phase.mode.layout.slots:
        return np.asarray(phase.p[0, phase.mode.layout.slots[slot]])
    return np.array(next(each.default for each in phase.mode.model.slots if each.name == slot))
