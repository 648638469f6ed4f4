"""Whole-body dynamics against Pinocchio: contacts, impacts, steps; what it binds and what it refuses."""

from itertools import combinations

import numpy as np
import pinocchio as pin
import pytest

from piaffe.models import Robot, WholeBody, load
from piaffe.models.robot import to_pinocchio

ROBOTS = ("mini_cheetah", "solo12", "go2", "anymal_c")


@pytest.fixture(scope="module", params=ROBOTS)
def body(request: pytest.FixtureRequest) -> WholeBody:
    return WholeBody(load(request.param))


def random_state(body: WholeBody, rng: np.random.Generator) -> np.ndarray:
    """Return a state anywhere on the manifold: any attitude, joints within ±1, speeds of order one."""
    n = body.robot.num_joints
    x = np.concatenate([rng.normal(size=7), rng.uniform(-1, 1, n), rng.normal(size=6 + n)])
    return body.state.np_normalise(x)


class Oracle:
    """Pinocchio's terms in Piaffe's layout: v = T v_pin with T = diag(R, 1)."""

    def __init__(self, robot: Robot, x: np.ndarray) -> None:
        model, data = robot.model, robot.model.createData()
        q, v = to_pinocchio(x)
        R = pin.Quaternion(q[3:7]).toRotationMatrix()
        T = np.eye(model.nv)
        T[:3, :3] = R
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        pin.updateFramePlacements(model, data)
        ids = [model.getFrameId(foot.frame) for foot in robot.feet]
        world = pin.LOCAL_WORLD_ALIGNED
        J = np.vstack([pin.getFrameJacobian(model, data, i, world)[:3] for i in ids])
        drift = np.concatenate([pin.getFrameClassicalAcceleration(model, data, i, world).linear for i in ids])
        # v_world = R v_local, so a_world = R (a_local + ω × v_local): at a_world = 0, a_local = −ω × v_local
        correction = np.zeros(model.nv)
        correction[:3] = -np.cross(v[3:6], v[:3])
        M = pin.crba(model, data, q)
        self.M = T @ (np.triu(M) + np.triu(M, 1).T) @ T.T + np.diag(np.r_[np.zeros(6), robot.armature])
        self.n = T @ pin.rnea(model, model.createData(), q, v, correction)
        self.J = J @ T.T
        self.drift = drift + J @ correction
        self.v = x[model.nq :]


def solve_contact(oracle: Oracle, u: np.ndarray, rows: np.ndarray, gamma: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (a, F) of the dense KKT system of the rows in contact."""
    J, nv = oracle.J[rows], len(oracle.n)
    K = np.block([[oracle.M, -J.T], [J, np.zeros((len(rows), len(rows)))]])
    right = np.concatenate([np.r_[np.zeros(6), u] - oracle.n, -oracle.drift[rows] - gamma * J @ oracle.v])
    z = np.linalg.solve(K, right)
    return z[:nv], z[nv:]


def subsets(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    return [subset for size in range(len(names) + 1) for subset in combinations(names, size)]


def rows_of(names: tuple[str, ...], chosen: tuple[str, ...]) -> np.ndarray:
    return np.array([3 * i + k for i, name in enumerate(names) if name in chosen for k in range(3)], dtype=int)


def assert_close(got: np.ndarray, expected: np.ndarray) -> None:
    """Compare to 1e-9 of the largest entry."""
    assert np.max(np.abs(got - expected), initial=0.0) <= 1e-9 * max(1.0, np.max(np.abs(expected), initial=0.0))


def test_mass_matrix_and_bias_match_pinocchio(body: WholeBody) -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        x = random_state(body, rng)
        oracle = Oracle(body.robot, x)
        assert_close(body.mass_matrix(x), oracle.M)
        assert_close(body.bias(x), oracle.n)
        assert_close(body.contact_jacobian(x), oracle.J)


def test_contact_solution_matches_pinocchio_for_every_contact_set(body: WholeBody) -> None:
    rng = np.random.default_rng(1)
    names = body.robot.foot_names
    for _ in range(100):
        x, u = random_state(body, rng), rng.normal(size=body.robot.num_joints)
        oracle = Oracle(body.robot, x)
        for standing in subsets(names):
            rows = rows_of(names, standing)
            acceleration, force = solve_contact(oracle, u, rows, gamma=20.0)
            expected = np.zeros(3 * len(names))
            expected[rows] = force
            feet = " ".join(standing)
            assert_close(body.acceleration(x, u, feet), acceleration)
            assert_close(body.contact_forces(x, u, feet).ravel(), expected)


def test_impact_matches_pinocchio_for_every_landing(body: WholeBody) -> None:
    rng = np.random.default_rng(2)
    names, nq = body.robot.foot_names, body.nq
    for _ in range(100):
        x = random_state(body, rng)
        oracle = Oracle(body.robot, x)
        for landing in subsets(names):
            rows = rows_of(names, landing)
            J, zero = oracle.J[rows], np.zeros((len(rows), len(rows)))
            K = np.block([[oracle.M, -J.T], [J, zero]])
            z = np.linalg.solve(K, np.concatenate([oracle.M @ oracle.v, np.zeros(len(rows))]))
            after = body.impact(x, " ".join(landing))
            assert_close(after[:nq], x[:nq])
            assert_close(after[nq:], z[: body.nv])
