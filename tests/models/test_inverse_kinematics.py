"""Joint angles from the places of feet, for every robot, in keyframes and in states."""

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ModelError, ProblemError, ShapeError, UnknownNameError
from piaffe.models import Kinematics
from piaffe.ocp import rotation

NAMES = ("mini_cheetah", "solo12", "go2", "anymal_c")
AT, TURNED = np.array([0.3, -0.2, 0.0]), np.array([0.08, -0.1, 0.7])


def places(robot, joints, position, rpy):
    found = Kinematics(robot).world_feet(position, rotation.np_from_rpy(np.array(rpy)), joints)
    return dict(zip(robot.foot_names, found, strict=True))


def of_pose(robot, name, position, rpy):
    return places(robot, robot.pose(name), np.array(position), rpy)


@pytest.mark.parametrize("name", NAMES)
def test_feet_reach_their_places(name) -> None:
    robot = models.load(name)
    position = AT + np.array([0, 0, 0.93 * robot.base_height()])
    scale = robot.base_height()
    rng = np.random.default_rng(3)
    standing = places(robot, robot.pose("stand"), position, TURNED)
    wanted = {foot: place + 0.12 * scale * rng.uniform(-1, 1, 3) for foot, place in standing.items()}
    joints = robot.inverse_kinematics(wanted, position, TURNED)
    for foot, place in places(robot, joints, position, TURNED).items():
        assert np.linalg.norm(place - wanted[foot]) < 1e-4
    assert np.all((robot.joint_lower <= joints) & (joints <= robot.joint_upper))


def test_legs_that_are_not_named_keep_their_angles() -> None:
    robot = models.load("solo12")
    crouch = robot.pose("crouch")
    before = of_pose(robot, "crouch", (0, 0, 0.2), (0, 0, 0))["HL"]
    joints = robot.inverse_kinematics({"HL": before + np.array([0.02, 0.01, 0.03])}, (0, 0, 0.2), joints="crouch")
    moved = [i for i, name in enumerate(robot.joint_names) if name.startswith("HL")]
    assert np.array_equal(np.delete(joints, moved), np.delete(crouch, moved))
    assert not np.allclose(joints[moved], crouch[moved], atol=1e-3)


@pytest.mark.parametrize("name", ["solo12", "go2"])
def test_keyframes_and_states_take_places_of_feet(name) -> None:
    robot = models.load(name)
    body = models.WholeBody(robot)
    position = (0.1, 0.0, 0.9 * robot.base_height())
    standing = of_pose(robot, "stand", position, (0, 0.1, 0))
    last = robot.foot_names[3]
    feet = {"FL": standing["FL"] + np.array([0.02, 0, 0.02]), last: standing[last] + np.array([-0.02, 0, 0.01])}
    expected = robot.inverse_kinematics(feet, position, (0, 0.1, 0))
    state = body.state(position=position, rpy=(0, 0.1, 0), feet=feet)
    assert np.array_equal(state[7 : 7 + robot.num_joints], expected)
    entries = body.keyframe({"position": position, "rpy": (0, 0.1, 0), "feet": feet})
    assert np.array_equal(entries[models.joints.position], expected)
    motion = ocp.Motion(ocp.Phase("stand", models.stance("FR"), 0.1, ocp.Keyframe(position=position, feet=feet)))
    path = motion.bind((body,), body.state.unpack(state))
    target = path.sample(0.1, path.interval_before(0.1))
    assert np.allclose(target[models.joints.position], robot.inverse_kinematics(feet, position))


@pytest.mark.parametrize("name", NAMES)
def test_places_of_feet_agree_with_pinocchio_and_are_inverted(name) -> None:
    robot = models.load(name)
    position = AT + np.array([0, 0, 0.9 * robot.base_height()])
    found = robot.forward_kinematics("crouch", position, TURNED)
    assert list(found) == list(robot.foot_names)
    for foot, place in places(robot, robot.pose("crouch"), position, TURNED).items():
        np.testing.assert_allclose(found[foot], place, atol=1e-12)
    again = robot.inverse_kinematics(found, position, TURNED, joints="crouch")
    np.testing.assert_allclose(again, robot.pose("crouch"), atol=1e-6)


def test_a_pose_without_a_place_stands_on_the_ground() -> None:
    robot = models.load("mini_cheetah")
    for rpy in ((0, 0, 0), (0.1, -0.4, 2.0)):
        lowest = min(place[2] for place in robot.forward_kinematics("stand", rpy=rpy).values())
        assert lowest == pytest.approx(robot.foot_radius, abs=1e-12)
    standing = robot.forward_kinematics()
    high = robot.base_height() + 0.04
    joints = robot.inverse_kinematics(standing, (0, 0.03, high))
    for foot, place in robot.forward_kinematics(joints, (0, 0.03, high)).items():
        np.testing.assert_allclose(place, standing[foot], atol=1e-4)
    with pytest.raises(ShapeError, match="forward kinematics, rpy: is unusable - got 3, expected three finite"):
        robot.forward_kinematics(rpy=3)


def test_what_cannot_be_reached_is_named() -> None:
    robot = models.load("mini_cheetah")
    with pytest.raises(ModelError, match=r"foot 'FR' is out of reach - got \[0\.2, -0\.1, -0\.6\] m, the nearest"):
        robot.inverse_kinematics({"FR": (0.2, -0.1, -0.6)}, (0, 0, 0.3))
    with pytest.raises(UnknownNameError, match="foot"):
        robot.inverse_kinematics({"LF": (0.2, 0.1, 0.0)}, (0, 0, 0.3))
    with pytest.raises(ShapeError, match=r"foot 'FL': is unusable - got \(0\.2, 0\.1\), expected three"):
        robot.inverse_kinematics({"FL": (0.2, 0.1)}, (0, 0, 0.3))
    with pytest.raises(ShapeError, match="position: is unusable"):
        robot.inverse_kinematics({"FL": (0.2, 0.1, 0.0)}, (0, 0, np.nan))
    with pytest.raises(ModelError, match="feet is unusable"):
        robot.inverse_kinematics([0.2, 0.1, 0.0], (0, 0, 0.3))
    with pytest.raises(ModelError, match="the base has no place"):
        models.WholeBody(robot).keyframe({"feet": {"FL": (0.2, 0.1, 0.0)}})


@pytest.mark.parametrize("foot", ["FX", "FL"])
def test_a_keyframe_out_of_reach_names_its_phase(foot) -> None:
    body = models.WholeBody(models.load("solo12"))
    keyframe = ocp.Keyframe(position=(0, 0, 0.2), feet={foot: (0.2, 0.15, 0.9)})
    motion = ocp.Motion(ocp.Phase("wave", models.stance("FR HL HR"), 0.2, keyframe))
    objective = ocp.Objective(ocp.regularize(models.joints.torque, weight=1.0))
    problem = ocp.Problem(motion, body.until_end(dt=0.02), objective, initial=body.state())
    with pytest.raises(ProblemError, match=rf"phase 'wave' \(test_inverse_kinematics\.py:\d+\): .*foot.*{foot}"):
        ocp.compile_problem(problem)
