"""The robots that tests run over: a new file in ``models/robots/`` needs its line here."""

from pathlib import Path
from tempfile import TemporaryDirectory

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


def panda_file() -> Path:
    """Return the URDF of the package example-robot-data."""
    robots = models.load("go2").urdf
    assert robots is not None
    return next(parent for parent in robots.parents if parent.name == "robots") / "panda_description/urdf/panda.urdf"
