"""Whole-body dynamics against Pinocchio: contacts, impacts, steps; what it binds and what it refuses."""

from dataclasses import replace
from itertools import combinations

import casadi as cs
import numpy as np
import pinocchio as pin
import pytest

from piaffe import ocp
from piaffe.errors import ModelError, ShapeError, UnknownNameError
from piaffe.models import Foot, Robot, WholeBody, base, feet, frames, joints, load, stance
from piaffe.models.integrators import Integrator
from piaffe.models.robot import to_pinocchio
from piaffe.ocp.language.model import Node
from tests.robots import ROBOTS


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
            acceleration, force = solve_contact(oracle, u, rows, gamma=20.0 / body.sizes.time)
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


# ---- steps and states


@pytest.mark.parametrize(("integrator", "order"), [("euler", 1), ("semi_implicit", 1), ("midpoint", 2)])
def test_flight_keeps_momentum(integrator: Integrator, order: int) -> None:
    body = WholeBody(load("solo12"), integrator=integrator)
    rng = np.random.default_rng(4)
    start = body.state(
        angular_velocity=(2.0, -1.0, 3.0), linear_velocity=(0.5, 0.2, 1.0), joint_velocities=rng.normal(size=12)
    )
    u, duration, drifts = 0.02 * rng.normal(size=12), 0.1, []
    p0, L0 = momenta(body, start)
    for steps in (200, 400):
        x = start
        for _ in range(steps):
            x = body.step(x, u, "", duration / steps)
        p1, L1 = momenta(body, x)
        drifts.append(np.linalg.norm(np.r_[p1 - p0 - body.robot.mass * np.array([0, 0, -9.81]) * duration, L1 - L0]))
    assert drifts[0] < 0.02 * np.linalg.norm(np.r_[p0, L0])
    assert drifts[0] / drifts[1] == pytest.approx(2**order, rel=0.05)


def momenta(body: WholeBody, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    model = body.robot.model
    h = pin.computeCentroidalMomentum(model, model.createData(), *to_pinocchio(x))
    return h.linear, h.angular


def test_feet_at_rest_stay_at_rest(body: WholeBody) -> None:
    x, all_feet = body.state(), " ".join(body.robot.foot_names)
    u = np.zeros(body.robot.num_joints)
    foot_acceleration = body.contact_jacobian(x) @ body.acceleration(x, u, all_feet)
    np.testing.assert_allclose(foot_acceleration, 0.0, atol=1e-9)


def test_slots_change_numbers_without_rebuilding(body: WholeBody) -> None:
    x = body.state()
    heavier = body.numbers()["link_mass"] * 2
    np.testing.assert_allclose(body.bias(x, link_mass=heavier)[:3], 2 * body.bias(x)[:3], atol=1e-9)
    fall = body.acceleration(x, np.zeros(12), "", gravity=(0, 0, -1.62))
    assert (fall[2], fall[6]) == pytest.approx((-1.62, 0.0), abs=1e-6)
    rotors = body.numbers()["armature"] + 1.0
    added = body.mass_matrix(x, armature=rotors) - body.mass_matrix(x)
    np.testing.assert_allclose(added, np.diag(np.r_[np.zeros(6), np.ones(12)]), atol=1e-12)


def test_state_stands_on_the_ground_by_default(body: WholeBody) -> None:
    for rpy in ((0, 0, 0), (0.2, -0.3, 1.0)):
        x = body.state(rpy=rpy, joints="crouch")
        assert body.foot_positions(x)[:, 2].min() == pytest.approx(body.robot.foot_radius, abs=1e-12)
        np.testing.assert_array_equal(x[body.nq :], 0.0)


def test_state_takes_everything_by_name(body: WholeBody) -> None:
    name = body.robot.joint_names[0]
    velocities = np.arange(12.0)
    x = body.state(position=(1, 2, 3), joints={name: 0.5}, linear_velocity=(4, 5, 6), joint_velocities=velocities)
    parts = body.state.unpack(x)
    np.testing.assert_array_equal(parts[base.position], [1, 2, 3])
    np.testing.assert_array_equal(parts[base.linear_velocity], [4, 5, 6])
    np.testing.assert_array_equal(parts[joints.velocity], velocities)
    assert parts[joints.position][0] == 0.5


# ---- what terms see


def evaluate(body: WholeBody, x: np.ndarray, u: np.ndarray, standing: str) -> dict[str, np.ndarray]:
    """Return every quantity that the model binds."""
    sx, su = cs.SX.sym("x", body.state.nx), cs.SX.sym("u", body.control.nx)
    sz, p = cs.SX.sym("z", body.implicit_size("contact")), body.symbols()
    quantities = body.dynamics("contact", sx, su, sz, p).quantities
    bounds = [quantities.bind(path) for path in quantities.paths]
    for bound in bounds:
        assert bound.value.shape == (4 if bound.quantity.kind == "rotation" else bound.size, 1), bound.quantity
    function = cs.Function("q", [sx, su, sz, *p.values()], [bound.value for bound in bounds])
    z = np.concatenate([body.acceleration(x, u, standing), body.contact_forces(x, u, standing).ravel()])
    values = function(x, u, z, *body.numbers(contact=body.flags(standing), terrain=0.1).values(), 0.01)
    return {bound.quantity.path: value.full().ravel() for bound, value in zip(bounds, values, strict=True)}


def test_quantities_match_pinocchio(body: WholeBody) -> None:
    rng, robot, names = np.random.default_rng(5), body.robot, body.robot.foot_names
    x, u, standing = random_state(body, rng), rng.normal(size=12), f"{names[0]} {names[3]}"
    got = evaluate(body, x, u, standing)
    model, data = robot.model, robot.model.createData()
    h = pin.computeCentroidalMomentum(model, data, *to_pinocchio(x))
    pin.forwardKinematics(model, data, *to_pinocchio(x))
    pin.updateFramePlacements(model, data)
    feet_at = np.array([data.oMf[model.getFrameId(foot.frame)].translation for foot in robot.feet])
    expected = {
        **{quantity.path: value for quantity, value in body.state.unpack(x).items()},
        "joints.torque": u,
        "joints.acceleration": body.acceleration(x, u, standing)[6:],
        "feet.position": feet_at.ravel(),
        "feet.velocity": body.contact_jacobian(x) @ x[body.nq :],
        "feet.height": feet_at[:, 2] - 0.1 - robot.foot_radius,
        "feet.force": body.contact_forces(x, u, standing).ravel(),
        "feet.contact": np.array([1.0, 0, 0, 1]),
        "com.position": pin.centerOfMass(model, data, to_pinocchio(x)[0]),
        "com.velocity": h.linear / robot.mass,
        "momentum": h.angular,
    }
    for foot in robot.feet:
        velocity = pin.getFrameVelocity(model, data, model.getFrameId(foot.frame), pin.LOCAL_WORLD_ALIGNED)
        expected[f"frames.{foot.frame}.position"] = data.oMf[model.getFrameId(foot.frame)].translation
        expected[f"frames.{foot.frame}.velocity"] = velocity.linear
    for path, value in expected.items():
        np.testing.assert_allclose(got[path], value, atol=1e-10 * max(1.0, robot.mass), err_msg=path)


def test_every_frame_is_a_quantity(body: WholeBody) -> None:
    got = evaluate(body, body.state(), np.zeros(12), "")
    for frame in body.robot.model.frames:
        if frame.parentJoint > 0:
            assert frames[frame.name].position.path in got
            assert frames[frame.name].velocity.path in got


def test_force_is_masked_by_contact_and_switching_by_landing() -> None:
    body = WholeBody(load("mini_cheetah"))
    x, u, z, p = cs.SX.sym("x", 37), cs.SX.sym("u", 12), cs.SX.sym("z", 30), body.symbols()
    dynamics = body.dynamics("contact", x, u, z, p)
    force, switching = dynamics.quantities.bind(feet.force), body.switching("contact", dynamics.quantities, p)
    assert force.mask is not None
    assert switching.mask is not None
    masks = cs.Function("masks", [p["contact"], p["landing"]], [force.mask, switching.mask])([1, 0, 0, 1], [0, 1, 0, 0])
    np.testing.assert_array_equal(masks[0].full().ravel(), np.repeat([1, 0, 0, 1], 3))
    np.testing.assert_array_equal(masks[1].full().ravel(), [0, 1, 0, 0])
    assert switching.quantity == feet.height
    assert force.labels[:4] == ("FL x", "FL y", "FL z", "FR x")


# ---- modes and keyframes


def test_node_parameters_contain_standing_and_landing_feet() -> None:
    body = WholeBody(load("mini_cheetah"))
    node = Node(0.0, stance("FL HR"), stance("FL FR"), {})
    np.testing.assert_array_equal(body.node_parameters(node)["contact"], [1, 0, 0, 1])
    np.testing.assert_array_equal(body.node_parameters(node)["landing"], [0, 1, 0, 0])
    assert body.lands(node)
    inside = Node(0.0, stance("FL HR"), None, {})
    np.testing.assert_array_equal(body.node_parameters(inside)["landing"], np.zeros(4))
    assert not body.lands(inside)
    assert not body.lands(Node(0.0, stance("FL HR"), stance("FL"), {}))


def test_contact_sets_are_values_in_any_spelling() -> None:
    body = WholeBody(load("anymal_c"))
    assert stance("RH LF") == stance(["LF", "RH"])
    assert hash(stance("RH LF")) == hash(stance("LF RH"))
    assert body.resolve("RH LF") == body.resolve(stance("LF RH"))
    assert body.resolve(stance(roles="front")) == stance("LF RF")
    assert body.resolve(stance(roles="front left")) == stance("LF")
    assert body.resolve(stance(roles=("front left", "hind right"))) == stance("LF RH")
    assert body.resolve(str(stance("RH LF"))) == stance("LF RH")
    assert str(stance("")) == ""
    assert body.mode_key("LF") == body.mode_key("") == "contact"


def test_keyframes_use_the_robots_names() -> None:
    body = WholeBody(load("mini_cheetah"))
    words = {"position": (1, 2, 3), "rpy": (7.0, 0, 0), "joints": "crouch", "feet.force": np.arange(12)}
    targets = body.keyframe(words)
    np.testing.assert_array_equal(targets[base.orientation], [7.0, 0, 0])  # the winding survives
    np.testing.assert_array_equal(targets[joints.position], body.robot.pose("crouch"))
    assert set(targets) == {base.position, base.orientation, joints.position, feet.force}
    x, y, yaw = body.planar_frame(body.state.unpack(body.state(position=(1, 2, 3), rpy=(0.3, 0.2, 0.7))))
    assert (x, y, yaw) == pytest.approx((1, 2, 0.7))


# ---- refusals


def test_unknown_names_are_refused() -> None:
    body = WholeBody(load("mini_cheetah"))
    x = body.state()
    with pytest.raises(UnknownNameError, match=r"no foot 'RL' - got 'RL', expected one of \['FL', 'FR', 'HL', 'HR'\]"):
        body.acceleration(x, np.zeros(12), "RL")
    with pytest.raises(UnknownNameError, match="no role 'middle'"):
        body.resolve(stance(roles="middle"))
    with pytest.raises(UnknownNameError, match=r"no target 'postion' - got 'postion'.*did you mean 'position'"):
        body.keyframe({"postion": (0, 0, 0)})
    with pytest.raises(UnknownNameError, match="no parameter 'graviti'"):
        body.bias(x, graviti=(0, 0, 0))
    with pytest.raises(ModelError, match="mode is not a contact set - got 3, expected the feet on the ground"):
        body.mode_key(3)
    with pytest.raises(ModelError, match=r"models\.WholeBody: not a robot - got 'solo12', expected what models\.load"):
        WholeBody("solo12")  # type: ignore[arg-type]
    with pytest.raises(ModelError, match=r"baumgarte is out of range - got -1, expected a finite number ≥ 0"):
        WholeBody(body.robot, baumgarte=-1)


def test_wrong_sizes_are_refused() -> None:
    body = WholeBody(load("mini_cheetah"))
    with pytest.raises(ShapeError, match="argument 'x': wrong size - got 36 entries, expected 37"):
        body.mass_matrix(np.zeros(36))
    with pytest.raises(
        ShapeError, match=r"target 'rpy': wrong size - got shape \(2,\), expected \(3,\) for x, y, z \[rad\]"
    ):
        body.keyframe({"rpy": (0, 1)})
    with pytest.raises(ShapeError, match="parameter 'gravity': wrong size - got 1 entries, expected 3"):
        body.bias(body.state(), gravity=9.81)


def test_redundant_contacts_are_refused_by_name_unless_damped() -> None:
    robot = load("solo12")
    robot = replace(robot, feet=(*robot.feet, Foot("FL_knee", "FL_KFE")))
    with pytest.raises(ModelError, match="redundant contact points - got FL_knee beside FL, FR, HL, HR, expected"):
        WholeBody(robot)
    with pytest.raises(ModelError, match=r"contact_damping is out of range - got 0\.0, expected a positive"):
        WholeBody(robot, contact_damping=0.0)
    damped = WholeBody(robot, contact_damping=1e-6)
    x, u = damped.state(), np.zeros(12)
    a = damped.acceleration(x, u, "FL FR HL HR FL_knee")
    assert np.all(np.isfinite(a))
    slip = damped.contact_jacobian(x) @ a
    np.testing.assert_allclose(slip, 0.0, atol=1e-3)


def test_the_gain_of_contacts_follows_the_time_step_unless_given() -> None:
    robot = load("mini_cheetah")
    node = Node(0.0, stance("FL HR"), None, {}, dt=0.02)
    assert WholeBody(robot).node_parameters(node)["gamma"] == pytest.approx(100.0)
    assert [WholeBody(robot).gamma(dt) for dt in (0.02, 0.01, 0.001)] == [100.0, 200.0, 200.0]
    assert WholeBody(robot, integrator="euler").gamma(0.01) == 20.0
    assert WholeBody(robot, baumgarte=7.0).gamma(0.01) == 7.0
    assert "gamma" not in WholeBody(robot, integrator="euler").node_parameters(node)
    assert "gamma" not in WholeBody(robot, baumgarte=20.0).node_parameters(node)
    assert "gamma" not in WholeBody(robot).node_parameters(Node(0.0, stance("FL HR"), None, {}))
    motion = ocp.Motion(ocp.Phase("stand", stance("FL FR HL HR"), 0.1))
    body = WholeBody(robot)
    objective = ocp.Objective(ocp.regularize("joints.torque"))
    problem = ocp.Problem(motion, body.until_end(dt=0.02), objective, initial=body.state(joints="stand"))
    (phase,) = ocp.compile_problem(problem).phases
    np.testing.assert_allclose(phase.p[:, phase.mode.layout.slots["gamma"]], 100.0)
