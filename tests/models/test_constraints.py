"""Rows, masks, bounds and names of the constraints that go with legs."""

from types import SimpleNamespace

import casadi as cs
import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ProblemError

ROBOT = models.load("go2")
MODEL = SimpleNamespace(name="go2", robot=ROBOT)


def rows(expression):
    return np.array(cs.evalf(cs.SX(expression))).ravel()


def node(**feet):
    return SimpleNamespace(feet=SimpleNamespace(**{key: cs.SX(value) for key, value in feet.items()}))


def test_friction_pyramid_has_five_faces_per_foot_and_masks_feet_in_the_air():
    friction = models.friction_cone(mu=0.5)
    force = [1.0, -2.0, 10.0, 0, 0, 0, 6.0, 0, 10.0, 0, 0, -3.0]
    s = node(contact_force=force, contact=[1, 0, 1, 1])
    faces = rows(friction.function(s, mu=cs.SX(friction.parameters["mu"]))).reshape(4, 5)
    assert faces[0] == pytest.approx([10, 4, 6, 7, 3])
    assert faces[2] == pytest.approx([10, -1, 11, 5, 5])
    assert faces[3].min() < 0
    assert rows(friction.mask(s)).reshape(4, 5).tolist() == [[1] * 5, [0] * 5, [1] * 5, [1] * 5]
    assert friction.labels(MODEL)[5:7] == ("FR normal", "FR -x")


def test_constraints_of_one_kind_share_their_code():
    assert models.friction_cone(0.4).structure() == models.friction_cone(0.8).structure()
    assert models.foot_clearance(0.0).structure() == models.foot_clearance(0.01).structure()
    assert models.torque_limits(0.5).labels is models.torque_limits().labels


@pytest.mark.parametrize(
    ("constraint", "lower", "upper"),
    [
        (models.torque_limits(0.5), -0.5 * ROBOT.torque_limit, 0.5 * ROBOT.torque_limit),
        (models.joint_limits(0.1), ROBOT.joint_lower + 0.1, ROBOT.joint_upper - 0.1),
        (models.joint_speed_limits(), -ROBOT.joint_speed_limit, ROBOT.joint_speed_limit),
    ],
)
def test_joint_bounds_are_the_robot_s(constraint, lower, upper):
    assert constraint.bound("lower", MODEL, 12) == pytest.approx(lower)
    assert constraint.bound("upper", MODEL, 12) == pytest.approx(upper)
    assert constraint.labels(MODEL) == ROBOT.joint_names


def test_range_of_some_joints():
    hips = models.joint_range("hip_joint", 0.2, scale=0.2)
    assert hips.labels(MODEL) == tuple(f"{leg}_hip_joint" for leg in ("FL", "FR", "RL", "RR"))
    assert (hips.lower, hips.upper, hips.scale) == (-0.2, 0.2, 0.2)
    assert hips.structure() == models.joint_range("hip_joint", 0.3, scale=0.2).structure()
    assert hips.structure() != models.joint_range("calf_joint", 0.2, scale=0.2).structure()
    assert models.joint_range("FL", upper=1.0).labels(MODEL) == ROBOT.joint_names[:3]
    with pytest.raises(
        ProblemError, match=r"joint_range \(.*py:\d+\): no bound - got none, expected limit, lower or upper; give one"
    ):
        models.joint_range("FL")
    with pytest.raises(
        ProblemError, match=r"joint_range \(.*py:\d+\): limit is out of range - got -1, expected a number ≥ 0"
    ):
        models.joint_range("FL", -1)


def test_base_height_has_two_bounds():
    heights = models.base_height(0.1, maximum=0.3, scale=0.3)
    assert (heights.lower, heights.upper, heights.scale) == (0.1, 0.3, 0.3)
    assert rows(heights.function(SimpleNamespace(base=SimpleNamespace(height=cs.SX(0.2))))) == pytest.approx([0.2])
    with pytest.raises(
        ProblemError, match=r"base_height \(.*py:\d+\): no bound - got none, expected minimum or maximum; give one"
    ):
        models.base_height()


def test_clearance_concerns_feet_in_the_air_that_have_not_just_left():
    clearance = models.foot_clearance()
    s = node(contact=[1, 0, 0, 1], lifting=[0, 1, 0, 0], clearance=[0.0, 0.01, 0.02, 0.03])
    assert rows(clearance.mask(s)).tolist() == [0, 0, 1, 0]
    assert rows(clearance.function(s)) == pytest.approx([0.0, 0.01, 0.02, 0.03])


def test_numbers_out_of_range_are_refused():
    with pytest.raises(
        ProblemError, match=r"friction_cone \(.*py:\d+\): mu is out of range - got -0\.1, expected a positive number"
    ):
        models.friction_cone(mu=-0.1)
    with pytest.raises(
        ProblemError, match=r"joint_limits \(.*py:\d+\): margin is out of range - got -1, expected a number ≥ 0"
    ):
        models.joint_limits(-1)
    with pytest.raises(
        ProblemError, match=r"friction_cone \(.*py:\d+\): mu is out of range - got 'dry', expected a positive"
    ):
        models.friction_cone(mu="dry")


@pytest.mark.parametrize(
    ("make", "scale"),
    [
        (models.friction_cone, 50.0), (models.torque_limits, 4.0), (models.joint_limits, 0.5),
        (models.joint_speed_limits, 3.0), (models.foot_clearance, 0.02),
    ],
)  # fmt: skip
def test_a_violation_is_divided_by_the_scale(make, scale):
    body = models.WholeBody(models.load("solo12"))
    motion = ocp.Motion(
        ocp.Phase("stand", models.stance("FL FR HL HR"), 0.04), ocp.Phase("fly", models.stance(""), 0.04)
    )
    objective = ocp.Objective(ocp.regularize(models.joints.torque, weight=1.0))

    def values(constraint):
        problem = ocp.Problem(
            motion, body.until_end(dt=0.02), objective, ocp.Constraints(constraint), initial=body.state()
        )
        phase = ocp.compile_problem(problem).phases[0]
        x, u = body.state(joints="crouch"), np.full(12, 0.3)
        *_, g, _ = phase.mode.functions["stage"](x, u, np.full(phase.mode.nz, 2.0), phase.p[0])
        return g.full().ravel()

    assert np.allclose(values(make()), scale * values(make(scale=scale)), atol=1e-9)
