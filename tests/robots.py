"""The robots that tests run over: a new file in ``models/robots/`` needs its line here."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pinocchio

from piaffe import models
from tests.urdf import crane

ROBOTS = (
    "anymal_c",
    "go2",
    "mini_cheetah",
    "solo12",
)

EXTRA = ("crane", "panda")
"""A floating robot with prismatic joints, and an arm on the world; see :func:`load`."""


def load(name: str) -> models.Robot:
    """Return a robot of ``ROBOTS`` or ``EXTRA``."""
    if name in ROBOTS:
        return models.load(name)
    if name == "panda":
        return models.load(
            panda_file(), base="fixed", locked={"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
        )
    with TemporaryDirectory() as folder:
        urdf = Path(folder) / "crane.urdf"
        urdf.write_text(crane())
        return models.load(urdf, feet=("l_foot", "r_foot"), foot_radius=0.01)


def scaled(robot: models.Robot, size: float) -> models.Robot:
    """Return a robot of the same density with all lengths times ``size``; its times are those of free fall."""
    model, time = robot.model.copy(), size**0.5
    for i, inertia in enumerate(model.inertias):
        model.inertias[i] = pinocchio.Inertia(
            inertia.mass * size**3, inertia.lever * size, inertia.inertia * size**5
        )  # fmt: skip
        place = model.jointPlacements[i]
        model.jointPlacements[i] = pinocchio.SE3(place.rotation, place.translation * size)
    for frame in model.frames:
        frame.placement = pinocchio.SE3(frame.placement.rotation, frame.placement.translation * size)
    return replace(
        robot, model=model, foot_radius=robot.foot_radius * size, torque_limit=robot.torque_limit * size**4,
        joint_speed_limit=robot.joint_speed_limit / time, armature=robot.armature * size**5,
        joint_damping=robot.joint_damping * size**4 * time, joint_friction=robot.joint_friction * size**4,
        urdf=None, recipe={},
    )  # fmt: skip


def panda_file() -> Path:
    """Return the URDF of the package example-robot-data."""
    robots = models.load("go2").urdf
    assert robots is not None
    return next(parent for parent in robots.parents if parent.name == "robots") / "panda_description/urdf/panda.urdf"
