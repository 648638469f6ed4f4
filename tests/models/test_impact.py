"""Impacts with held feet: which feet take part, what they leave behind, against Pinocchio and closed forms."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from piaffe.errors import ModelError
from piaffe.models import WholeBody, load, stance
from piaffe.models.robot import to_pinocchio
from piaffe.ocp import Node
from tests.robots import ROBOTS


@pytest.fixture(scope="module", params=ROBOTS)
def body(request: pytest.FixtureRequest) -> WholeBody:
    return WholeBody(load(request.param))


def moving(body: WholeBody, seed: int) -> np.ndarray:
    """Return a state near the standing one, with speeds of order one."""
    rng = np.random.default_rng(seed)
    n = body.robot.num_joints
    pose = body.robot.pose("stand") + 0.3 * rng.standard_normal(n)
    return body.state(
        joints=pose, rpy=0.3 * rng.standard_normal(3), linear_velocity=rng.standard_normal(3),
        angular_velocity=rng.standard_normal(3), joint_velocities=rng.standard_normal(n),
    )  # fmt: skip


def diagonals(body: WholeBody) -> tuple[str, str]:
    names = body.robot.foot_names
    return f"{names[0]} {names[-1]}", f"{names[1]} {names[2]}"


def energy(body: WholeBody, x: np.ndarray) -> float:
    v = x[body.nq :]
    return float(0.5 * v @ body.mass_matrix(x) @ v)


def test_every_foot_of_the_following_contact_set_takes_part(body: WholeBody) -> None:
    one, other = diagonals(body)
    every, first = stance(" ".join(body.robot.foot_names)), stance(one)
    impact = body.node_parameters(Node(0.0, first, every, {}))["impact"]
    np.testing.assert_array_equal(impact, np.ones(4))
    impact = body.node_parameters(Node(0.0, first, stance(other), {}))["impact"]  # the feet that lift are free
    np.testing.assert_array_equal(impact, body.flags(other))


def test_no_foot_takes_part_where_none_lands(body: WholeBody) -> None:
    one, _ = diagonals(body)
    every = stance(" ".join(body.robot.foot_names))
    for node in (Node(0.0, every, stance(one), {}), Node(0.0, every, every, {}), Node(0.0, stance(one), None, {})):
        np.testing.assert_array_equal(body.node_parameters(node)["impact"], np.zeros(4))


def test_the_published_rule_leaves_standing_feet_out() -> None:
    body = WholeBody(load("mini_cheetah"), impact="landing")
    node = Node(0.0, stance("FL HR"), stance("FL FR HL HR"), {})
    np.testing.assert_array_equal(body.node_parameters(node)["impact"], [0, 1, 1, 0])
    np.testing.assert_array_equal(body.node_parameters(node)["landing"], [0, 1, 1, 0])


def test_an_unknown_rule_is_refused() -> None:
    expected = "impact is unknown - got 'all', expected 'contact' or 'landing'; choose one"
    with pytest.raises(ModelError, match=expected):
        WholeBody(load("mini_cheetah"), impact="all")  # type: ignore[arg-type]  # that is the point


def test_impact_with_held_feet_matches_impulse_dynamics_of_pinocchio(body: WholeBody) -> None:
    robot = body.robot
    model, data = robot.model, robot.model.createData()
    model.armature[:] = np.r_[np.zeros(6), robot.armature]
    for seed in range(10):
        x = moving(body, seed)
        q, v = to_pinocchio(x)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        frames = [model.getFrameId(foot.frame) for foot in robot.feet]
        J = np.vstack([pin.getFrameJacobian(model, data, i, pin.LOCAL_WORLD_ALIGNED)[:3] for i in frames])
        after = pin.impulseDynamics(model, data, q, v, J, 0.0, 0.0)  # local axes of the base
        _, expected = to_pinocchio(body.impact(x, " ".join(robot.foot_names)))
        np.testing.assert_allclose(after, expected, atol=1e-9 * max(1.0, np.abs(expected).max()))


def test_damped_contacts_yield_in_proportion_to_their_impulse() -> None:
    d, feet = 0.5, "FL FR"
    body = WholeBody(load("solo12"), contact_damping=d)
    x = moving(body, 3)
    rows = np.repeat(body.flags(feet), 3) > 0
    v, M, J = x[body.nq :], body.mass_matrix(x), body.contact_jacobian(x)[rows]
    impulse = -np.linalg.solve(J @ np.linalg.solve(M, J.T) + d * np.eye(6), J @ v)
    after = body.impact(x, feet)[body.nq :]
    np.testing.assert_allclose(after, v + np.linalg.solve(M, J.T @ impulse), atol=1e-9)
    assert np.linalg.norm(J @ after) > 1e-2


def test_rotors_take_part_in_an_impact() -> None:
    body, feet = WholeBody(load("solo12")), "FL FR"
    x, inertia = moving(body, 4), np.linspace(0.01, 0.05, 12)
    rows = np.repeat(body.flags(feet), 3) > 0
    M = body.mass_matrix(x, armature=np.zeros(12)) + np.diag(np.r_[np.zeros(6), inertia])
    J, v = body.contact_jacobian(x)[rows], x[body.nq :]
    impulse = -np.linalg.solve(J @ np.linalg.solve(M, J.T), J @ v)
    after = body.impact(x, feet, armature=inertia)[body.nq :]
    np.testing.assert_allclose(after, v + np.linalg.solve(M, J.T @ impulse), atol=1e-9)


def test_held_and_landing_feet_rest_after_an_impact(body: WholeBody) -> None:
    one, _ = diagonals(body)
    names = body.robot.foot_names
    for seed in range(10):
        x = moving(body, seed)
        after = body.impact(x, " ".join(names))
        np.testing.assert_allclose(body.contact_jacobian(after) @ after[body.nq :], np.zeros(12), atol=1e-9)
        partly = body.impact(x, one)
        speeds = np.linalg.norm((body.contact_jacobian(x) @ partly[body.nq :]).reshape(-1, 3), axis=1)
        assert np.all((speeds < 1e-9) == (body.flags(one) > 0))


def test_energy_never_grows_and_more_feet_take_more(body: WholeBody) -> None:
    names = body.robot.foot_names
    for seed in range(10):
        x = moving(body, seed)
        left = [energy(body, x)] + [energy(body, body.impact(x, " ".join(names[:n]))) for n in range(1, 5)]
        assert all(after <= before * (1 + 1e-12) for before, after in pairwise(left))


def test_an_impact_of_feet_at_rest_changes_nothing(body: WholeBody) -> None:
    every = " ".join(body.robot.foot_names)
    x = body.impact(moving(body, 0), every)
    np.testing.assert_allclose(body.impact(x, every), x, atol=1e-10)
