"""The recursions against Pinocchio: every frame, momentum, forces; their derivatives and their size."""

import casadi as cs
import numpy as np
import pinocchio as pin
import pytest

from piaffe.errors import ModelError
from piaffe.models import Robot, WholeBody
from piaffe.models.integrators import Integrator
from piaffe.models.recursions import Recursion
from piaffe.models.robot import to_pinocchio
from piaffe.models.tree import Inertials, Point, Tree
from tests.robots import ROBOTS, load

WORLD = pin.LOCAL_WORLD_ALIGNED
GRAVITY = np.array([0.0, 0.0, -9.81])


@pytest.fixture(scope="module", params=[*ROBOTS, "crane"])
def robot(request: pytest.FixtureRequest) -> Robot:
    return load(request.param)


def random_state(robot: Robot, rng: np.random.Generator) -> np.ndarray:
    q, n = rng.normal(size=7), robot.num_joints
    q[3:] /= np.linalg.norm(q[3:])
    return np.concatenate([q, rng.uniform(-1, 1, n), rng.normal(size=6 + n)])


def body_acceleration(x: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return Pinocchio's acceleration: its base part is the derivative of the velocity in body axes."""
    _, v = to_pinocchio(x)
    R = pin.Quaternion(x[[4, 5, 6, 3]]).toRotationMatrix()
    return np.concatenate([R.T @ a[:3] - np.cross(v[3:6], v[:3]), a[3:]])


def symbols(tree: Tree) -> tuple[cs.SX, cs.SX, cs.SX, Inertials]:
    n = tree.num_links
    inertials = Inertials.of(*(cs.SX(cs.DM(part.ravel())) for part in (tree.mass, tree.com, tree.inertia)))
    return cs.SX.sym("q", n + 6), cs.SX.sym("v", n + 5), cs.SX.sym("a", n + 5), inertials


def test_every_frame_moves_as_in_pinocchio(robot: Robot) -> None:
    tree, model = Tree.from_pinocchio(robot.model), robot.model
    q, v, a, _ = symbols(tree)
    motion = Recursion(tree, q, v, a)
    moving = [i for i, frame in enumerate(model.frames) if frame.parentJoint > 0]
    points = [Point(model.frames[i].parentJoint - 1, model.frames[i].placement.translation) for i in moving]
    rows = [cs.horzcat(*map(f, points)) for f in (motion.point, motion.velocity, motion.acceleration)]
    combined = cs.horzcat(*(motion.acceleration(point, 7.0) for point in points))
    function = cs.Function("frames", [q, v, a], [*rows, combined])
    rng = np.random.default_rng(0)
    for _ in range(5):
        x, acceleration = random_state(robot, rng), rng.normal(size=model.nv)
        data = model.createData()
        pin.forwardKinematics(model, data, *to_pinocchio(x), body_acceleration(x, acceleration))
        pin.updateFramePlacements(model, data)
        got = [value.full() for value in function(x[: model.nq], x[model.nq :], acceleration)]
        expected = [
            np.column_stack([data.oMf[i].translation for i in moving]),
            np.column_stack([pin.getFrameVelocity(model, data, i, WORLD).linear for i in moving]),
            np.column_stack([pin.getFrameClassicalAcceleration(model, data, i, WORLD).linear for i in moving]),
        ]
        for value, reference in zip(got[:3], expected, strict=True):
            np.testing.assert_allclose(value, reference, atol=1e-11)
        np.testing.assert_allclose(got[3], expected[2] + 7.0 * expected[1], atol=1e-10)


def test_momentum_and_centre_of_mass_match_pinocchio(robot: Robot) -> None:
    tree, model = Tree.from_pinocchio(robot.model), robot.model
    q, v, _, body = symbols(tree)
    motion = Recursion(tree, q, v)
    function = cs.Function("sums", [q, v], [motion.centre_of_mass(body), *motion.momentum(body)])
    rng = np.random.default_rng(1)
    for _ in range(20):
        x, data = random_state(robot, rng), model.createData()
        expected = pin.computeCentroidalMomentum(model, data, *to_pinocchio(x))
        com, linear, angular = (value.full().ravel() for value in function(x[: model.nq], x[model.nq :]))
        np.testing.assert_allclose(com, pin.centerOfMass(model, data, to_pinocchio(x)[0]), atol=1e-12)
        np.testing.assert_allclose(linear, expected.linear, atol=1e-11 * robot.mass)
        np.testing.assert_allclose(angular, expected.angular, atol=1e-11 * robot.mass)


def test_inverse_dynamics_with_forces_on_any_link_matches_pinocchio(robot: Robot) -> None:
    tree, model = Tree.from_pinocchio(robot.model), robot.model
    q, v, a, body = symbols(tree)
    rng = np.random.default_rng(2)
    points = [Point(link, rng.normal(size=3)) for link in range(tree.num_links)]
    pushes = rng.normal(size=(tree.num_links, 3))
    forces = [(point, cs.SX(cs.DM(push))) for point, push in zip(points, pushes, strict=True)]
    effort = Recursion(tree, q, v, a).inverse_dynamics(body, cs.SX(cs.DM(GRAVITY)), forces)
    function = cs.Function("rnea", [q, v, a], [effort])
    for _ in range(20):
        x, acceleration, data = random_state(robot, rng), rng.normal(size=model.nv), model.createData()
        pin.forwardKinematics(model, data, to_pinocchio(x)[0])
        external = pin.StdVec_Force()
        external.append(pin.Force.Zero())
        for joint, (point, push) in enumerate(zip(points, pushes, strict=True), start=1):
            local = data.oMi[joint].rotation.T @ push
            external.append(pin.Force(local, np.cross(point.offset, local)))
        expected = pin.rnea(model, data, *to_pinocchio(x), body_acceleration(x, acceleration), external)
        expected[:3] = pin.Quaternion(x[[4, 5, 6, 3]]).toRotationMatrix() @ expected[:3]
        got = function(x[: model.nq], x[model.nq :], acceleration).full().ravel()
        np.testing.assert_allclose(got, expected, atol=1e-10 * robot.mass)


def test_mass_matrix_is_the_derivative_of_inverse_dynamics(robot: Robot) -> None:
    tree = Tree.from_pinocchio(robot.model)
    q, v, a, body = symbols(tree)
    effort = Recursion(tree, q, v, a).inverse_dynamics(body, cs.SX.zeros(3))
    function = cs.Function("M", [q, v, a], [cs.jacobian(effort, a), Recursion(tree, q).mass_matrix(body)])
    x = random_state(robot, np.random.default_rng(3))
    by_derivative, by_composites = function(x[: robot.model.nq], x[robot.model.nq :], 0)
    np.testing.assert_allclose(by_composites.full(), by_derivative.full(), atol=1e-12 * robot.mass)


@pytest.mark.parametrize("name", ["mini_cheetah", "crane", "panda"])
def test_derivatives_on_the_manifold_match_finite_differences(name: str) -> None:
    body = WholeBody(load(name))
    nu, nf = body.control.nx, body.num_feet
    nx, ndx, nz = body.state.nx, body.state.ndx, body.implicit_size("contact")
    x, u, z, p = cs.SX.sym("x", nx), cs.SX.sym("u", nu), cs.SX.sym("z", nz), body.symbols()
    dx, slots = cs.SX.sym("dx", ndx), list(p.values())
    residual = body.dynamics("contact", x, u, z, p).implicit
    slope = cs.jacobian(cs.substitute(residual, x, body.state.nudge(x, dx)), dx)
    value = cs.Function("r", [x, u, z, *slots], [residual])
    derivative = cs.Function("r_x", [x, u, z, *slots], [cs.substitute(slope, dx, cs.SX.zeros(ndx))])
    rng = np.random.default_rng(4)
    numbers = [*body.numbers(contact=[1, 0, 1, 0.5][:nf]).values(), 0.01]
    at = random_state(body.robot, rng) if body.robot.base == "free" else rng.normal(size=nx)
    rest = (rng.normal(size=nu), rng.normal(size=nz), *numbers)
    h = 1e-6
    ends = [[value(body.state.np_plus(at, s * h * e), *rest).full().ravel() for e in np.eye(ndx)] for s in (1, -1)]
    expected = (np.array(ends[0]) - np.array(ends[1])).T / (2 * h)
    # central differences: error h² times third derivatives, and rounding over h
    np.testing.assert_allclose(derivative(at, *rest).full(), expected, atol=1e-7 * np.abs(expected).max())


def test_residual_is_affine_in_acceleration_and_force(robot: Robot) -> None:
    body = WholeBody(robot)
    x, u = cs.SX.sym("x", body.state.nx), cs.SX.sym("u", body.control.nx)
    z, p = cs.SX.sym("z", body.implicit_size("contact")), body.symbols()
    assert not cs.depends_on(cs.jacobian(body.dynamics("contact", x, u, z, p).implicit, z), z)
    assert not cs.depends_on(cs.jacobian(body.reset("contact", x, z, p).implicit, z), z)


@pytest.mark.parametrize(("integrator", "most"), [("euler", 40_000), ("midpoint", 48_000)])
def test_residual_and_its_derivatives_stay_small(robot: Robot, integrator: Integrator, most: int) -> None:
    body = WholeBody(robot, integrator=integrator)
    x, u, dx = cs.SX.sym("x", body.state.nx), cs.SX.sym("u", body.control.nx), cs.SX.sym("dx", body.state.ndx)
    z, p = cs.SX.sym("z", body.implicit_size("contact")), body.symbols()
    residual = body.dynamics("contact", x, u, z, p).implicit
    slope = cs.jacobian(cs.substitute(residual, x, body.state.nudge(x, dx)), cs.vertcat(dx, u, z))
    slope = cs.substitute(slope, dx, cs.SX.zeros(body.state.ndx))
    function = cs.Function("d", [x, u, z, *p.values()], [residual, slope], {"cse": True})
    # measured: 24 000 with axis-aligned joints, 34 000 for ANYmal; with midpoint steps 32 000 and 42 500
    assert function.n_instructions() < most


def test_fixed_base_is_refused() -> None:
    model = pin.buildSampleModelManipulator()
    with pytest.raises(ModelError, match=r"no floating base - got 6 joints, expected a free-flyer"):
        Tree.from_pinocchio(model)


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        (pin.JointModelHZ(0.1), "got a joint that turns and slides, expected one of both"),
        (pin.JointModelRUBZ(), "got nq 2, expected a revolute joint"),
    ],
)
def test_joints_that_are_neither_revolute_nor_prismatic_are_refused(joint: pin.JointModel, message: str) -> None:
    model = pin.Model()
    model.name = "crane"
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.addJoint(root, joint, pin.SE3.Identity(), "hoist")
    with pytest.raises(ModelError, match=message) as caught:
        Tree.from_pinocchio(model)
    assert "robot 'crane', joint 'hoist'" in str(caught.value)
