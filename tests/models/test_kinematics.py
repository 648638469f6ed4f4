"""Leg kinematics in batches, against Pinocchio and against itself."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from piaffe import models
from piaffe.models.legs import _damped_step
from piaffe.models.robot import to_pinocchio
from tests.robots import ROBOTS


def random_poses(rng, robot, count):
    position, quaternion = rng.normal(size=(count, 3)), rng.normal(size=(count, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    return position, quaternion, robot.pose("stand") + rng.uniform(-0.6, 0.6, (count, robot.num_joints))


@pytest.fixture(scope="module", params=ROBOTS)
def legs(request):
    return models.Kinematics(models.load(request.param))


def test_feet_match_pinocchio(legs):
    robot = legs.robot
    position, quaternion, joints = random_poses(np.random.default_rng(0), robot, 10)
    feet = legs.world_feet(position, quaternion, joints)
    data = robot.model.createData()
    for s in range(10):
        q, _ = to_pinocchio(np.concatenate([position[s], quaternion[s], joints[s], np.zeros(robot.model.nv)]))
        pinocchio.framesForwardKinematics(robot.model, data, q)
        oracle = [data.oMf[robot.frame_id(foot.frame)].translation for foot in robot.feet]
        assert feet[s] == pytest.approx(np.array(oracle), abs=1e-12)


def test_leg_jacobians_match_finite_differences(legs):
    rng, step = np.random.default_rng(1), 1e-6
    for group in legs.groups:
        angles = rng.uniform(-1, 1, group.joints.shape)
        _, jacobian = group.jacobian(angles)
        for i in range(angles.shape[1]):
            nudge = np.zeros_like(angles)
            nudge[:, i] = step
            difference = (group.jacobian(angles + nudge)[0] - group.jacobian(angles - nudge)[0]) / (2 * step)
            assert jacobian[..., i] == pytest.approx(difference, abs=1e-9)


def test_inverse_returns_to_the_feet_and_to_the_same_knees(legs):
    robot = legs.robot
    position, quaternion, joints = random_poses(np.random.default_rng(2), robot, 100)
    joints = np.clip(joints, robot.joint_lower, robot.joint_upper)
    feet = legs.world_feet(position, quaternion, joints)
    found, miss = legs.world_inverse(position, quaternion, feet)
    assert miss.max() < 1e-9
    assert legs.world_feet(position, quaternion, found) == pytest.approx(feet, abs=1e-9)
    stand = robot.pose("stand").reshape(4, 3)
    knees = found.reshape(-1, 4, 3)[..., 2]
    assert np.all(np.sign(knees) == np.sign(stand[:, 2]))


def test_inverse_out_of_reach_points_the_leg_there_and_reports_the_miss():
    legs = models.Kinematics(models.load("mini_cheetah"))
    feet = legs.feet(legs.robot.pose("stand"))
    feet[:, 2] = -1.0
    joints, miss = legs.inverse(feet)
    reached = legs.feet(joints)
    assert np.linalg.norm(feet - reached, axis=-1) == pytest.approx(miss)
    assert miss == pytest.approx(1.0 - legs.reach, abs=0.02)
    assert np.all(joints <= legs.robot.joint_upper)


def test_inverse_keeps_within_joint_limits():
    legs = models.Kinematics(models.load("go2"))
    rng = np.random.default_rng(3)
    joints, _ = legs.inverse(legs.feet(legs.robot.pose("stand")) + rng.uniform(-0.5, 0.5, (50, 4, 3)))
    assert np.all(joints >= legs.robot.joint_lower)
    assert np.all(joints <= legs.robot.joint_upper)


def test_joint_velocities_move_the_feet_as_asked(legs):
    rng = np.random.default_rng(4)
    joints = legs.robot.pose("stand") + rng.uniform(-0.2, 0.2, (20, legs.robot.num_joints))
    rates, step = rng.normal(size=(20, len(legs.robot.feet), 3)), 1e-6
    velocities = legs.joint_velocities(joints, rates)
    moved = (legs.feet(joints + step * velocities) - legs.feet(joints - step * velocities)) / (2 * step)
    assert moved == pytest.approx(rates, abs=1e-5)


def test_standing_pose_puts_feet_below_their_neutral_places_with_knees_behind(legs):
    pose = legs.standing_pose(0.7)
    feet, neutral = legs.feet(pose), legs.feet(np.zeros(legs.robot.num_joints))
    assert feet[:, :2] == pytest.approx(neutral[:, :2], abs=1e-6)
    assert np.ptp(feet[:, 2]) < 1e-6
    for group in legs.groups:
        _, origins, _ = group.forward(pose[group.joints])
        assert np.all(origins[:, -1, 0] <= feet[group.feet, 0] + 1e-6)


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_damped_inverse_of_a_straight_leg_is_the_least_motion(joints):
    rng = np.random.default_rng(3)
    jacobian = rng.normal(size=(3, 1)) * rng.uniform(0.2, 1.0, joints)  # of rank one
    if joints == 3:
        jacobian[:, 0] += rng.normal(size=3)
    rate, damping = rng.normal(size=3), 1e-9
    expected = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(3), rate)
    found = _damped_step(jacobian[..., None, None], rate[:, None, None], np.array(damping))[:, 0, 0]
    assert found == pytest.approx(expected, rel=1e-4)


def test_a_foot_on_the_base_stays_there():
    robot = models.load("solo12")
    robot = replace(robot, feet=(replace(robot.feet[0], frame="base_link"), *robot.feet[1:]))
    legs = models.Kinematics(robot)
    feet = legs.feet(np.random.default_rng(0).uniform(-1, 1, (50, robot.num_joints)))
    frame = robot.model.frames[robot.frame_id("base_link")]
    assert feet[:, 0] == pytest.approx(np.tile(frame.placement.translation, (50, 1)))
    assert np.isfinite(legs.standing_pose(0.8)).all()
