"""A robot is known by one file: the loader finds it, and nothing else names it."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from piaffe import models
from piaffe.models import robots
from piaffe.models.robots import known
from tests.robots import ROBOTS

MY_DOG = '''
"""A Solo12 with bigger feet."""

from piaffe.models.robots import KnownRobot

ROBOT = KnownRobot(
    urdf="solo_description/robots/solo12.urdf",
    legs=("FL", "FR", "HL", "HR"),
    foot_frame="{}_FOOT",
    foot_radius=0.02,
    poses={"stand": ((0.0, 0.8, -1.6),) * 2 + ((0.0, -0.8, 1.6),) * 2, "crouch": ((0.0, 1.1, -2.2),)},
    limits={"torque": (3.0, 2.0, 1.0), "angle": (1.0, 2.0, 2.5), "speed": (20.0, 20.0, 10.0)},
)
'''


@pytest.fixture
def my_dog(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """One more file in the package of robots."""
    (tmp_path / "my_dog.py").write_text(MY_DOG)
    (tmp_path / "helper.py").write_text("ROBOT = 'no robot'\n")
    monkeypatch.setattr(robots, "__path__", [*robots.__path__, str(tmp_path)])
    known._robots.cache_clear()
    yield
    known._robots.cache_clear()
    for name in ("my_dog", "helper"):
        sys.modules.pop(f"{robots.__name__}.{name}", None)
        vars(robots).pop(name, None)


def test_every_file_of_a_robot_is_in_the_list_of_the_tests() -> None:
    assert robots.names() == ROBOTS


@pytest.mark.usefixtures("my_dog")
def test_a_file_makes_a_robot_known() -> None:
    assert robots.names() == tuple(sorted([*ROBOTS, "my_dog"]))
    robot = models.load("my_dog")
    assert robot.name == "my_dog"
    assert robot.foot_radius == 0.02
    assert robot.torque_limit.tolist() == [3.0, 2.0, 1.0] * 4
    assert robot.joint_lower.tolist() == [-1.0, -2.0, -2.5] * 4
    assert robot.pose("stand").tolist() == [0.0, 0.8, -1.6] * 2 + [0.0, -0.8, 1.6] * 2
    assert models.robot_from_recipe(robots.robot_recipe(robot)).foot_radius == 0.02


def test_an_import_of_the_package_imports_no_robot() -> None:
    code = "import sys, piaffe.models; print(*(m for m in sys.modules if m.startswith('piaffe.models.robots.')))"
    imported = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "piaffe.models.robots.load" in imported
    assert {f"piaffe.models.robots.{name}" for name in ROBOTS} & set(imported) == set()
