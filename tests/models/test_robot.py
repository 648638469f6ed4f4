"""Robots: their numbers, names, poses, and the messages when something is asked that they lack."""

from dataclasses import replace
from math import pi

import numpy as np
import pinocchio
import pytest

from piaffe import models
from piaffe.errors import ModelError, ShapeError, UnknownNameError
from piaffe.models.robot import to_pinocchio
from piaffe.ocp import rotation
from tests.robots import ROBOTS


@pytest.fixture(scope="module")
def cheetah():
    return models.load("mini_cheetah")


@pytest.mark.parametrize("name", ROBOTS)
def test_every_known_robot_loads_with_four_feet_of_all_roles(name):
    robot = models.load(name)
    corners = {(front, side) for front in ("front", "hind") for side in ("left", "right")}
    assert {tuple(sorted(foot.roles)) for foot in robot.feet} == {tuple(sorted(corner)) for corner in corners}
    assert robot.num_joints == 12
    assert robot.name == name
    for pose in ("stand", "crouch"):
        assert np.all(robot.pose(pose) >= robot.joint_lower)
        assert np.all(robot.pose(pose) <= robot.joint_upper)
    assert robot.base_height("crouch") < 0.8 * robot.base_height("stand")


@pytest.mark.parametrize("name", ROBOTS)
def test_stand_has_all_feet_on_the_ground_below_the_centre_of_mass(name):
    robot = models.load(name)
    q = pinocchio.neutral(robot.model)
    q[2], q[7:] = robot.base_height("stand"), robot.pose("stand")
    data = robot.model.createData()
    pinocchio.framesForwardKinematics(robot.model, data, q)
    feet = np.array([data.oMf[robot.frame_id(foot.frame)].translation for foot in robot.feet])
    assert feet[:, 2] == pytest.approx(robot.foot_radius, abs=1e-9)
    com = pinocchio.centerOfMass(robot.model, data, q)
    assert com[:2] == pytest.approx(feet[:, :2].mean(axis=0), abs=0.05 * np.ptp(feet[:, 0]))


def test_mini_cheetah_has_the_published_mass_names_and_limits(cheetah):
    assert cheetah.mass == pytest.approx(8.252, abs=1e-9)
    assert cheetah.joint_names == tuple(f"{leg}_{j}" for leg in ("FL", "FR", "HL", "HR") for j in ("HAA", "HFE", "KFE"))
    assert cheetah.foot_names == ("FL", "FR", "HL", "HR")
    assert cheetah.foot_radius == 0.0175
    assert cheetah.torque_limit == pytest.approx(17.0)
    assert cheetah.joint_speed_limit == pytest.approx(20.0)
    assert cheetah.joint_upper == pytest.approx(np.tile([1.3, 5.0, pi], 4), abs=1e-15)
    assert cheetah.joint_lower == pytest.approx(-cheetah.joint_upper)
    assert not cheetah.armature.any()


@pytest.mark.parametrize(
    ("pose", "height"),  # cafe-mpc's model, foot radius 0
    [((0, -1, 2), 0.2183), ((0, -1.2, 2.4), 0.1464), ((0, -0.9, 1.8), 0.2511), ((0, -1.1, 2.2), 0.1833)],
)
def test_mini_cheetah_stands_at_the_published_heights(pose, height):
    robot = models.load("mini_cheetah", foot_radius=0.0)
    assert robot.base_height(np.tile(pose, 4)) == pytest.approx(height, abs=5e-5)


def test_mini_cheetah_reproduces_the_published_feet_and_flight_acceleration():
    """Configuration and velocities all one, torque zero; world linear and joint accelerations."""
    robot = models.load("mini_cheetah", foot_radius=0.0)
    rpy = np.ones(3)
    omega = rotation.np_body_rate(rpy, np.ones(3))
    x = np.concatenate([np.ones(3), rotation.np_from_rpy(rpy), np.ones(12), np.ones(3), omega, np.ones(12)])
    q, v = to_pinocchio(x)
    data = robot.model.createData()
    a = pinocchio.aba(robot.model, data, q, v, np.zeros(18))
    R = rotation.np_matrix(x[3:7])
    assert R @ (a[:3] + np.cross(v[3:6], v[:3])) == pytest.approx([0.0167, 0.0347, -9.8007], abs=6e-5)
    published = [0.8268, 0.6603, -5.2010, -0.2201, 1.3537, -4.9655, 1.0438, -1.0924, -0.5153, 0.1417, -0.2949, -0.2164]
    assert a[6:] == pytest.approx(published, abs=6e-5)
    pinocchio.framesForwardKinematics(robot.model, data, q)
    feet = [data.oMf[robot.frame_id(foot.frame)].translation for foot in robot.feet]
    published = [
        [1.184079, 1.341408, 0.602812],
        [1.096458, 1.202452, 0.497336],
        [1.073147, 1.168641, 0.922571],
        [0.985526, 1.029685, 0.817095],
    ]
    assert np.array(feet) == pytest.approx(np.array(published), abs=6e-7)


def test_rotors_add_their_masses_and_reflected_inertia():
    robot = models.load("mini_cheetah", rotors=True)
    assert robot.mass == pytest.approx(8.912, abs=1e-9)
    assert robot.armature[:3] == pytest.approx([2.268e-3, 2.268e-3, 5.484e-3], abs=1e-6)
    assert robot.model.armature[6:] == pytest.approx(robot.armature)
    with pytest.raises(ModelError, match=r"got rotors=True, expected one of \['mini_cheetah', 'solo12'\]"):
        models.load("go2", rotors=True)


def test_damping_and_friction_are_numbers_per_joint_and_zero_by_default(cheetah):
    assert cheetah.joint_damping.tolist() == cheetah.joint_friction.tolist() == [0.0] * 12
    robot = models.load(
        "go2", joint_damping={"hip_joint": 0.1, "thigh_joint": 0.2, "calf_joint": 0.3}, joint_friction=0.5
    )
    assert robot.joint_damping == pytest.approx(np.tile([0.1, 0.2, 0.3], 4))
    assert robot.joint_friction == pytest.approx(np.full(12, 0.5))
    assert replace(robot, foot_radius=0.0).joint_damping is robot.joint_damping
    with pytest.raises(ModelError, match=r"models\.load, joint_damping of 'go2': no number for joint 'FL_hip_joint'"):
        models.load("go2", joint_damping={"thigh_joint": 0.2})
    with pytest.raises(ModelError, match=r"models\.load, joint_friction of 'go2': no number for joint .* got -0.1"):
        models.load("go2", joint_friction=-0.1)
    with pytest.raises(ModelError, match=r"robot 'go2': joint_damping is out of range - got .* per joint \[Nm s/rad\]"):
        replace(robot, joint_damping=np.full(12, np.inf))
    with pytest.raises(ShapeError, match=r"robot 'go2', joint_friction: wrong size - got 3 entries, expected 12"):
        replace(robot, joint_friction=np.ones(3))


def test_pose_takes_a_name_numbers_or_labels(cheetah):
    assert cheetah.pose("lean")[:6] == pytest.approx([pi / 6, -1, 2, -pi / 5, -0.5, 1])
    assert cheetah.pose("tuck")[6:9] == pytest.approx([0.3, -1.1, 2.2])
    assert cheetah.pose(range(12)) == pytest.approx(np.arange(12.0))
    posed = cheetah.pose({"HAA": 0.2, "FR": (0.1, -0.9, 1.8), "HL_KFE": 1.5})
    expected = [0.2, -1, 2, 0.1, -0.9, 1.8, 0.2, -1, 1.5, 0.2, -1, 2]
    assert posed == pytest.approx(expected)


def test_pose_does_not_hand_out_the_robot_s_own_array(cheetah):
    cheetah.pose("stand")[:] = 7.0
    assert cheetah.pose("stand")[1] == -1.0


@pytest.mark.parametrize(
    ("pose", "error", "message"),
    [
        ("sit", UnknownNameError, r"robot 'mini_cheetah': no pose 'sit' - got 'sit', expected one of \['stand'"),
        (np.zeros(11), ShapeError, r"robot 'mini_cheetah', joints: wrong size - got 11 entries, expected 12 \(FL_HAA"),
        ({"FL": (1, 2)}, ShapeError, r"label 'FL': wrong size - got 2 entries, expected 1 or 3 \(FL_HAA, FL_HFE"),
        ({"FX": 1.0}, UnknownNameError, r"no component 'FX' - got 'FX', expected one of"),
        ({"KF": 1.0}, UnknownNameError, r"did you mean 'KFE'.*HAA, HFE, KFE in every leg, FL, FR, HL, HR for a leg$"),
        ("sit", UnknownNameError, r"add it: models.load\(..., poses={'sit': angles}\), or write .* {'KFE': 2}$"),
        ("stanb", UnknownNameError, r"did you mean 'stand' or 'lean'\?$"),
        (object(), ModelError, r"joints: not joint angles - got .*, expected the name of a pose \(stand"),
    ],
)
def test_pose_errors_say_what_was_got_and_expected(cheetah, pose, error, message):
    with pytest.raises(error, match=message):
        cheetah.pose(pose)


def test_feet_are_found_by_roles(cheetah):
    assert [foot.name for foot in cheetah.feet_with("front left")] == ["FL"]
    assert [foot.name for foot in cheetah.feet_with(("right",))] == ["FR", "HR"]
    assert len(cheetah.feet_with("")) == 4
    with pytest.raises(UnknownNameError, match="no role 'rear' - got 'rear', expected one of"):
        cheetah.feet_with("rear")
    with pytest.raises(UnknownNameError, match="no foot 'RL' - got 'RL', expected one of"):
        cheetah.foot("RL")


@pytest.mark.parametrize("name", ROBOTS)
def test_a_joint_knows_the_foot_that_it_moves(name):
    robot = models.load(name)
    q, data = pinocchio.neutral(robot.model), robot.model.createData()
    pinocchio.computeJointJacobians(robot.model, data, q)
    pinocchio.updateFramePlacements(robot.model, data)
    for foot, each in enumerate(robot.feet):
        jacobian = pinocchio.getFrameJacobian(
            robot.model, data, robot.frame_id(each.frame), pinocchio.ReferenceFrame.WORLD
        )
        moves = np.abs(jacobian[:, 6:]).max(axis=0) > 1e-9
        np.testing.assert_array_equal(moves, np.array(robot.foot_of_joint) == foot)


def test_a_joint_that_moves_no_foot_or_several_has_none(cheetah):
    fewer = replace(cheetah, feet=cheetah.feet[1:])
    assert fewer.foot_of_joint == (-1, -1, -1, 0, 0, 0, 1, 1, 1, 2, 2, 2)
    base, twice = cheetah.feet[0], replace(cheetah.feet[1], name="toe", frame=cheetah.feet[0].frame)
    assert replace(cheetah, feet=(base, twice)).foot_of_joint == (-1,) * 12


def test_robots_know_their_frames(cheetah):
    with pytest.raises(UnknownNameError, match=r"no frame 'FL_TOE' .* did you mean"):
        cheetah.frame_id("FL_TOE")


def test_a_urdf_file_loads_with_roles_and_poses_of_its_own(cheetah):
    frames = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
    robot = models.load(
        cheetah.urdf, feet=frames, foot_radius=0.02, name="mine", poses={"crouch": np.tile([0, -1, 2], 4)}
    )
    assert robot.name == "mine"
    assert robot.foot_names == ("FL", "FR", "HL", "HR")
    assert [foot.roles for foot in robot.feet] == [foot.roles for foot in cheetah.feet]
    assert robot.pose("crouch") == pytest.approx(np.tile([0, -1, 2], 4))
    stand = robot.pose("stand").reshape(4, 3)
    assert np.all(stand[:, 1] < 0), "knees behind"
    assert np.all(stand[:, 2] > 0), "knees behind"
    assert 0.25 < robot.base_height("stand") < 0.4


def test_loading_says_what_is_missing(cheetah, tmp_path):
    with pytest.raises(UnknownNameError, match=r"no robot 'mini_cheta' .* did you mean 'mini_cheetah'"):
        models.load("mini_cheta")
    with pytest.raises(ModelError, match=r"no such file - got .*none\.urdf"):
        models.load(tmp_path / "none.urdf")
    with pytest.raises(ModelError, match=r"no feet - got feet=None, expected the frames .* \['FL_SHANK', 'FL_FOOT'"):
        models.load(cheetah.urdf)
    with pytest.raises(UnknownNameError, match="no frame 'FL_TOE'"):
        models.load(cheetah.urdf, feet=("FL_TOE",))
    assert models.load(cheetah.urdf, feet="FL_FOOT HR_FOOT").foot_names == ("FL", "HR")
    with pytest.raises(ModelError, match=r"foot_radius is not a length - got -0\.1"):
        models.load("mini_cheetah", foot_radius=-0.1)


def test_a_continuous_joint_is_a_revolute_one_without_limits(cheetah, tmp_path):
    urdf = tmp_path / "wheels.urdf"
    text = cheetah.urdf.read_text().replace('name="FL_KFE" type="revolute"', 'name="FL_KFE" type="continuous"')
    urdf.write_text(text)
    robot = models.load(urdf, feet=("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"))
    assert (robot.model.nq, robot.model.nv) == (19, 18)
    assert (robot.joint_lower[2], robot.joint_upper[2]) == (-np.inf, np.inf)
    assert (robot.torque_limit[2], robot.joint_speed_limit[2]) == (17.0, 20.0)
    assert robot.joint_upper[5] == pytest.approx(pi)
    assert robot.joint_axis(4) == pytest.approx(cheetah.joint_axis(4))


def test_the_visual_geometry_of_mini_cheetah_is_made_of_primitives(cheetah):
    kinds = {type(item.geometry).__name__ for item in cheetah.visual.geometryObjects}
    assert kinds == {"Box", "Cylinder", "Sphere"}
