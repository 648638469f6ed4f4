"""Arms on the world, prismatic, continuous and passive joints, against Pinocchio, MuJoCo and closed forms."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import casadi as cs
import mujoco
import numpy as np
import pinocchio as pin
import pytest

from piaffe import models, ocp, simulation
from piaffe.errors import ModelError, PiaffeError, ProblemError
from piaffe.models import base, gaits, joints, stance
from piaffe.models.recursions import Recursion
from piaffe.models.robot import to_pinocchio
from piaffe.models.tree import Inertials, Point, Tree
from tests.robots import load, panda_file
from tests.urdf import FEET, cart, joint, link, robot

PENDULUM = robot(
    link("world")
    + joint("swing", "world", "bob", kind="{}", xyz="0 0 2", limit="{}")
    + link("bob", 1.0, "0 0 -1", 1.0),
    "pendulum",
)
WIDE = '<limit lower="-3" upper="3" effort="5" velocity="9"/>'


@pytest.fixture(scope="module")
def panda():
    return load("panda")


@pytest.fixture(scope="module")
def on_the_world(panda):
    """The same arm as Pinocchio reads it without a floating base."""
    full = pin.buildModelFromUrdf(str(panda_file()))
    fingers = [full.getJointId(f"panda_finger_joint{i}") for i in (1, 2)]
    at = pin.neutral(full)
    for finger in fingers:
        at[full.joints[finger].idx_q] = 0.02
    return pin.buildReducedModel(full, fingers, at)


def states(robot, count, seed=0):
    rng = np.random.default_rng(seed)
    n = robot.num_joints
    for _ in range(count):
        yield rng.uniform(-1.5, 1.5, n), rng.normal(size=n), rng.normal(size=n) * 5


@pytest.mark.parametrize(("kind", "limit"), [("revolute", WIDE), ("continuous", ""), ("continuous", WIDE)])
def test_a_level_pendulum_falls_at_half_of_gravity(kind, limit, tmp_path):
    """m g l / (I + m l²) with m = 1 kg, l = 1 m and I = 1 kg m² about the centre of mass."""
    urdf = tmp_path / "pendulum.urdf"
    urdf.write_text(PENDULUM.format(kind, limit))
    body = models.WholeBody(models.load(urdf, base="fixed"))
    assert (body.state.nx, body.state.ndx, body.nq, body.nv) == (2, 2, 1, 1)
    assert body.acceleration(body.state(joints=[pi / 2]), [0.0], "") == pytest.approx([-4.905], abs=1e-12)
    assert body.acceleration(body.state(joints=[-pi / 2]), [0.0], "") == pytest.approx([4.905], abs=1e-12)
    assert body.acceleration(body.state(), [1.0], "") == pytest.approx([0.5], abs=1e-12)


def test_an_angle_of_a_continuous_joint_counts_its_turns(tmp_path):
    urdf = tmp_path / "pendulum.urdf"
    urdf.write_text(PENDULUM.format("continuous", ""))
    body = models.WholeBody(models.load(urdf, base="fixed"))
    here, there = body.state(joints=[0.3]), body.state(joints=[0.3 + 8 * pi])
    assert body.state.np_minus(there, here) == pytest.approx([8 * pi, 0.0])
    assert body.acceleration(there, [0.0], "") == pytest.approx(body.acceleration(here, [0.0], ""), abs=1e-12)


def test_an_arm_accelerates_as_in_pinocchio(panda, on_the_world):
    body = models.WholeBody(panda)
    data = on_the_world.createData()
    for q, v, tau in states(panda, 20):
        expected = pin.aba(on_the_world, data, q, v, tau)
        got = body.acceleration(np.concatenate([q, v]), tau, "")
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
        M, n = pin.crba(on_the_world, data, q), pin.nonLinearEffects(on_the_world, data, q, v)
        np.testing.assert_allclose(body.mass_matrix(np.concatenate([q, v])), M, rtol=0, atol=1e-9 * np.abs(M).max())
        np.testing.assert_allclose(body.bias(np.concatenate([q, v])), n, rtol=0, atol=1e-9 * np.abs(n).max())


def test_frames_of_an_arm_move_as_in_pinocchio(panda, on_the_world):
    tree, model = Tree.from_pinocchio(panda.model, fixed=True), on_the_world
    q, v, a = (cs.SX.sym(name, 7) for name in "qva")
    motion = Recursion(tree, q, v, a)
    hand = panda.model.frames[panda.frame_id("panda_hand")]
    point = Point(hand.parentJoint - 1, hand.placement.translation)
    rows = [motion.point(point), motion.velocity(point), motion.acceleration(point), motion.jacobian(point)]
    body = Inertials.of(*(cs.SX(cs.DM(part.ravel())) for part in (tree.mass, tree.com, tree.inertia)))
    function = cs.Function("hand", [q, v, a], [*rows, motion.weight(body, cs.SX(cs.DM([0, 0, -9.81])))])
    data, frame, aligned = model.createData(), model.getFrameId("panda_hand"), pin.LOCAL_WORLD_ALIGNED
    for at, speed, faster in states(panda, 10, seed=1):
        pin.forwardKinematics(model, data, at, speed, faster)
        pin.updateFramePlacements(model, data)
        place, velocity, acceleration, J, weight = (each.full().squeeze() for each in function(at, speed, faster))
        np.testing.assert_allclose(place, data.oMf[frame].translation, atol=1e-12)
        np.testing.assert_allclose(velocity, pin.getFrameVelocity(model, data, frame, aligned).linear, atol=1e-12)
        expected = pin.getFrameClassicalAcceleration(model, data, frame, aligned).linear
        np.testing.assert_allclose(acceleration, expected, atol=1e-11)
        np.testing.assert_allclose(J, pin.computeFrameJacobian(model, data, at, frame, aligned)[:3], atol=1e-12)
        np.testing.assert_allclose(weight, pin.computeGeneralizedGravity(model, data, at), atol=1e-11)


def test_a_floating_robot_with_slides_accelerates_as_in_pinocchio():
    crane = load("crane")
    body, data = models.WholeBody(crane), crane.model.createData()
    rng, n = np.random.default_rng(2), crane.num_joints
    for _ in range(20):
        x = np.concatenate([rng.normal(size=7), rng.uniform(-1, 1, n), rng.normal(size=6 + n)])
        x[3:7] /= np.linalg.norm(x[3:7])
        u = rng.normal(size=n)
        q, v = to_pinocchio(x)
        expected = pin.aba(crane.model, data, q, v, np.concatenate([np.zeros(6), u]))
        R = pin.Quaternion(q[3:7]).toRotationMatrix()
        expected[:3] = R @ (expected[:3] + np.cross(v[3:6], v[:3]))
        np.testing.assert_allclose(body.acceleration(x, u, ""), expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["crane", "panda"])
def test_mujoco_s_scene_accelerates_as_the_whole_body(name):
    robot = load(name)
    body, model = models.WholeBody(robot), models.mujoco_model(robot, visuals=False)
    assert (model.nq, model.nv, model.nu) == (body.nq, body.nv, len(robot.motors))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, rng, n = mujoco.MjData(model), np.random.default_rng(0), robot.num_joints
    for _ in range(10):
        pose = rng.normal(size=7 if robot.base == "free" else 0)
        pose[3:] /= np.linalg.norm(pose[3:])
        x = np.concatenate([pose, rng.uniform(-1, 1, n), rng.normal(size=body.nv)])
        u = rng.uniform(-1, 1, n) * np.minimum(robot.torque_limit, 10.0)
        data.qpos[:], data.qvel[:], data.ctrl[:] = x[: model.nq], x[model.nq :], u
        mujoco.mj_forward(model, data)
        assert np.max(np.abs(body.acceleration(x, u, "") - data.qacc)) < 1e-8 * np.max(np.abs(data.qacc))


def test_a_step_of_an_arm_is_of_second_order(panda):
    body = models.WholeBody(panda)
    q, v, tau = next(states(panda, 1, seed=3))
    tau = tau + body.bias(np.concatenate([q, v]))

    def end(steps):
        x = np.concatenate([q, v])
        for _ in range(steps):
            x = body.step(x, tau, "", 0.02 / steps)
        return x

    fine = end(256)
    errors = [np.abs(end(steps) - fine).max() for steps in (4, 8)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)


def arm_problem(robot, **changes):
    body = models.WholeBody(robot)
    motion = ocp.Motion(ocp.Phase("reach", stance(""), 0.2, ocp.Keyframe(joints=[0.1, -0.2, 0, -1.5, 0, 1.6, 0.8])))
    objective = ocp.Objective(
        ocp.track(joints.position, weight=10.0), ocp.track(joints.velocity, weight=0.1),
        ocp.regularize(joints.torque, weight=1e-4),
    )  # fmt: skip
    limits = ocp.Constraints(models.torque_limits(), models.joint_limits(), models.joint_speed_limits())
    start = body.state(joints=[0, -0.3, 0, -1.7, 0, 1.5, 0.8])
    declared = {"motion": motion, "objective": objective, "limits": limits, "initial": start, **changes}
    return ocp.Problem(
        declared["motion"], body.until_end(dt=0.02), declared["objective"], declared["limits"],
        initial=declared["initial"],
    )  # fmt: skip


def test_derivatives_of_an_arm_s_problem_are_those_of_finite_differences(panda):
    compiled = ocp.compile_problem(arm_problem(panda))
    checks = ocp.check_derivatives(compiled)
    assert checks
    wrong = [each for each in checks if each.error > each.allowed or not each.smooth]
    assert not wrong, wrong


def test_what_a_fixed_base_does_not_have_is_refused_by_name(panda):
    body = models.WholeBody(panda)
    with pytest.raises(ModelError, match=r"models.SingleRigidBody: the base of '.*' is fixed - got base='fixed'"):
        models.SingleRigidBody(panda)
    with pytest.raises(ModelError, match=r"state of '.*', target 'position': the base of '.*' is fixed"):
        body.state(position=(0, 0, 1))
    with pytest.raises(ModelError, match=r"state of '.*', target 'rpy': the base of '.*' is fixed"):
        body.state(rpy=(0, 0, 1))
    lifted = ocp.Motion(ocp.Phase("up", stance(""), 0.2, ocp.Keyframe(position=(0, 0, 1))))
    with pytest.raises(PiaffeError, match=r"target 'position': the base of '.*' is fixed"):
        ocp.compile_problem(arm_problem(panda, motion=lifted))
    tilted = ocp.Objective(ocp.track(base.orientation, weight=1.0), ocp.regularize(joints.torque, weight=1.0))
    with pytest.raises(ProblemError, match=r"(?s)base\.orientation.*the base of '.*' is fixed"):
        ocp.compile_problem(arm_problem(panda, objective=tilted))
    with pytest.raises(ModelError, match=r"gait: the base of '.*' is fixed|no feet"):
        ocp.compile_problem(arm_problem(panda, motion=gaits.trot(speed=0.5).cycles(1)))


def test_a_recipe_keeps_the_base_and_the_locked_joints(panda):
    again = models.robot_from_recipe(models.WholeBody(panda).recipe())
    assert again.base == "fixed"
    assert again.joint_names == panda.joint_names
    assert again.num_joints == 7
    assert again.pose("stand") == pytest.approx(panda.pose("stand"))


def test_a_passive_joint_has_no_control(tmp_path):
    knee = ("l_knee", "l_thigh", "l_shank")
    passive = joint(*knee, xyz="0 0 -0.25", limit='<limit lower="-2" upper="2" effort="0" velocity="9"/>')
    text = cart().replace(joint(*knee, xyz="0 0 -0.25"), passive)
    urdf = tmp_path / "passive.urdf"
    urdf.write_text(text)
    loaded = models.load(urdf, feet=FEET)
    body = models.WholeBody(loaded)
    at = loaded.joint_names.index("l_knee")
    assert body.control.nx == 5
    assert "l_knee" not in loaded.motor_names
    rng = np.random.default_rng(0)
    u = rng.normal(size=5)
    full = np.insert(u, at, 0.0)
    x = body.state()
    driven = models.WholeBody(replace(loaded, torque_limit=np.full(6, 25.0)))
    assert body.acceleration(x, u, "") == pytest.approx(driven.acceleration(x, full, ""), abs=1e-12)
    assert models.mujoco_model(loaded, visuals=False).nu == 5
    assert models.Mujoco(loaded, action=models.torques()).control.nx == 5
    with pytest.raises(ModelError, match=r"joint_targets: robot 'cart' has joints without a motor - got \['l_knee'\]"):
        models.Mujoco(loaded)
    with pytest.raises(ModelError, match=r"whole body of 'cart': no joint has a motor - got a torque limit of zero"):
        models.WholeBody(replace(loaded, torque_limit=np.zeros(6)))


def test_rows_of_torque_limits_leave_out_passive_joints(panda):
    weak = replace(panda, torque_limit=np.where(np.arange(7) == 2, 0.0, panda.torque_limit))
    compiled = ocp.compile_problem(arm_problem(weak))
    names = [row.label for row in compiled.phases[0].mode.rows["stage_g"] if "torque" in compiled.terms[row.term].name]
    assert names
    assert not [name for name in names if "panda_joint3" in name]


@ocp.residual(unit="m")
def hand_away(s):
    """Return the hand relative to a point."""
    return s.frames.panda_hand.position - cs.DM([0.4, 0.1, 0.5])


def test_a_frame_of_an_arm_has_a_cost(panda):
    objective = ocp.Objective(ocp.regularize(joints.torque, weight=1e-4)) + hand_away.weighted(10.0)
    compiled = ocp.compile_problem(arm_problem(panda, objective=objective))
    wrong = [each for each in ocp.check_derivatives(compiled) if each.error > each.allowed or not each.smooth]
    assert not wrong, wrong
    x = compiled.initial
    data = panda.model.createData()
    q = pin.neutral(panda.model)
    q[7:] = x[:7]
    pin.framesForwardKinematics(panda.model, data, q)
    place = data.oMf[panda.frame_id("panda_hand")].translation
    phase = compiled.phases[0]
    residual = phase.mode.functions["stage"](x, np.zeros(phase.mode.nu), np.zeros(phase.mode.nz), phase.p[0])
    values = np.concatenate([part.full().ravel() for part in residual])
    for entry in place - [0.4, 0.1, 0.5]:
        assert np.min(np.abs(values - entry)) < 1e-12


def test_a_plant_names_what_it_does_not_support(panda):
    with pytest.raises(ModelError, match=r"plant: robot '.*' is not supported - got a fixed base, expected a floating"):
        simulation.Plant(panda)
    crane = load("crane")
    weak = replace(crane, torque_limit=np.where(np.arange(crane.num_joints) == 1, 0.0, crane.torque_limit))
    with pytest.raises(ModelError, match=r"plant: .* got joints without a motor, \['l_pitch'\]"):
        simulation.Plant(weak)
