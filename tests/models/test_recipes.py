"""What a file holds of a robot rebuilds that robot."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piaffe import models
from piaffe.errors import ModelError
from piaffe.models.robot import Robot
from piaffe.models.robots.recipes import robot_recipe

LOSSES = ("joint_damping", "joint_friction")


def assert_same(one: Robot, other: Robot) -> None:
    assert (one.name, one.feet, one.foot_radius, one.joint_names) == (
        other.name,
        other.feet,
        other.foot_radius,
        other.joint_names,
    )
    for name in ("torque_limit", "joint_lower", "joint_upper", "joint_speed_limit", "armature", *LOSSES):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert {k: v.tolist() for k, v in one.poses.items()} == {k: v.tolist() for k, v in other.poses.items()}
    assert one.mass == pytest.approx(other.mass, abs=1e-12)


@pytest.mark.parametrize("name", ["mini_cheetah", "solo12"])
def test_known_robot_comes_back_from_json(name: str) -> None:
    robot = models.load(name, rotors=name == "mini_cheetah", foot_radius=0.01, poses={"low": {"HAA": 0.1}})
    assert_same(models.robot_from_recipe(json.loads(json.dumps(robot_recipe(robot)))), robot)


def test_damping_and_friction_come_back_and_older_recipes_have_none() -> None:
    robot = models.load("go2", joint_damping=0.2, joint_friction=np.linspace(0.2, 1.0, 12))
    stored = json.loads(json.dumps(robot_recipe(robot)))
    assert_same(models.robot_from_recipe(stored), robot)
    older = {key: value for key, value in stored.items() if key not in LOSSES}
    assert_same(models.robot_from_recipe(older), models.load("go2"))


def test_robot_of_a_file_comes_back_without_the_file(tmp_path: Path) -> None:
    known = models.load("mini_cheetah")
    assert known.urdf is not None
    file = tmp_path / "mine.urdf"
    file.write_text(known.urdf.read_text())
    robot = models.load(file, feet=[foot.frame for foot in known.feet])
    robot = replace(robot, torque_limit=np.full(12, np.inf), joint_damping=np.full(12, 0.1))
    stored = json.loads(json.dumps(robot_recipe(robot), allow_nan=False))
    file.unlink()
    again = models.robot_from_recipe(stored)
    assert_same(again, robot)
    assert again.visual is not None
    assert again.visual.ngeoms > 0


def test_models_hold_their_robots_recipe() -> None:
    robot = models.load("mini_cheetah")
    for model in (models.WholeBody(robot), models.HybridKinodynamic(robot), models.SingleRigidBody(robot)):
        recipe = model.recipe()
        assert recipe["kind"] == type(model).__name__
        assert_same(models.robot_from_recipe(recipe), robot)


def test_empty_recipe_is_refused() -> None:
    with pytest.raises(ModelError, match=r"no robot in it - got keys \[\], expected 'load' or 'urdf'"):
        models.robot_from_recipe({})
