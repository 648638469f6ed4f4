"""Time steps of both models: against Pinocchio's terms and turns, flight against parabolas, feet that stand."""

import numpy as np
import pinocchio as pin
import pytest

from piaffe.errors import ModelError
from piaffe.models import Robot, SingleRigidBody, WholeBody, load, stance
from piaffe.models.integrators import INTEGRATORS, Integrator
from piaffe.models.robot import to_pinocchio
from piaffe.ocp import Node
from tests.robots import ROBOTS

from .test_whole_body import Oracle, random_state, rows_of, solve_contact

GRAVITY = np.array([0.0, 0.0, -9.81])


def parts(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return position, rotation matrix, joint angles and velocity of a state."""
    nq = (len(x) + 1) // 2
    return x[:3], pin.Quaternion(np.roll(x[3:7], -1)).toRotationMatrix(), x[7:nq], x[nq:]


def moved(x: np.ndarray, v: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, rotation matrix and joint angles after a time at a velocity, with Pinocchio's exponential."""
    p, R, q, _ = parts(x)
    return p + v[:3] * dt, R @ pin.exp3(v[3:6] * dt), q + v[6:] * dt


def expected_step(integrator: str, x: np.ndarray, a: np.ndarray, dt: float) -> list[np.ndarray]:
    """Return position, rotation matrix, joint angles and velocity one step later."""
    v = parts(x)[3]
    v_next = v + a * dt
    if integrator == "midpoint":
        p, R, q = moved(x, v, dt / 2)
        return [p + v_next[:3] * dt / 2, R @ pin.exp3(v_next[3:6] * dt / 2), q + v_next[6:] * dt / 2, v_next]
    return [*moved(x, v if integrator == "euler" else v_next, dt), v_next]


def squares_at(robot: Robot, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the parts of n and of the feet's acceleration that are quadratic in the velocity, at a velocity v."""
    moving, still = (Oracle(robot, np.concatenate([x[: -len(v)], each])) for each in (v, 0 * v))
    return moving.n - still.n, moving.drift


def midpoint_acceleration(robot: Robot, x: np.ndarray, u: np.ndarray, rows: np.ndarray, dt: float) -> np.ndarray:
    """Return a of the dynamics at q ⊕ ½ v dt, where quadratic terms are Q(v, v⁺) = Q(½ (v + v⁺)) − Q(½ (v⁺ − v))."""
    v = parts(x)[3]
    p, R, q = moved(x, v, dt / 2)
    quaternion = np.roll(pin.Quaternion(R).coeffs(), 1)
    x = np.concatenate([p, quaternion, q, v])
    still, a = Oracle(robot, np.concatenate([p, quaternion, q, 0 * v])), np.zeros(len(v))
    J = still.J[rows]
    K = np.block([[still.M, -J.T], [2 * J, np.zeros((len(rows), len(rows)))]])
    for _ in range(40):  # contracts, because dt is small
        (n, drift), (m, slip) = (squares_at(robot, x, each) for each in (v + a * dt / 2, a * dt / 2))
        force = np.r_[np.zeros(6), u] - still.n - n + m
        constraint = slip[rows] - drift[rows] - 2 * J @ v / dt  # γ = 2/dt; its part of a is in K
        a = np.linalg.solve(K, np.concatenate([force, constraint]))[: len(v)]
    return a


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("name", ROBOTS)
def test_whole_body_steps_match_pinocchio(name: str, integrator: Integrator) -> None:
    body, rng, dt = WholeBody(load(name), integrator=integrator), np.random.default_rng(0), 0.02
    standing = body.robot.foot_names[::3]
    rows = rows_of(body.robot.foot_names, standing)
    for _ in range(10):
        x, u = random_state(body, rng), rng.normal(size=body.robot.num_joints)
        if integrator == "midpoint":
            a = midpoint_acceleration(body.robot, x, u, rows, dt)
        else:
            a, _ = solve_contact(Oracle(body.robot, x), u, rows, gamma=body.gamma(dt))
        got = parts(body.step(x, u, " ".join(standing), dt))
        for part, wanted in zip(got, expected_step(integrator, x, a, dt), strict=True):
            np.testing.assert_allclose(part, wanted, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("integrator", ["euler", "midpoint"])
def test_rigid_body_steps_match_newton_and_euler(integrator: Integrator) -> None:
    tensor = np.array([[0.06, 0.01, 0.002], [0.01, 0.22, 0.003], [0.002, 0.003, 0.27]])
    body = SingleRigidBody(load("go2"), mass=9.0, inertia=tensor, integrator=integrator)
    rng, dt = np.random.default_rng(1), 0.05
    for _ in range(20):
        x, (forces, holds) = body.state.np_normalise(rng.normal(size=13)), rng.normal(size=(2, 4, 3))
        p, R, _ = moved(x, parts(x)[3], dt / 2 if integrator == "midpoint" else 0.0)
        omega, spin, torque = x[10:13], np.zeros(3), R.T @ np.cross(holds - p, forces).sum(axis=0)
        for _ in range(60):
            after = omega + spin * dt if integrator == "midpoint" else omega
            gyroscopic = 0.5 * (np.cross(omega, tensor @ after) + np.cross(after, tensor @ omega))
            spin = np.linalg.solve(tensor, torque - gyroscopic)
        a = np.concatenate([forces.sum(axis=0) / 9.0 + GRAVITY, spin])
        got = parts(body.step(x, forces, "FL FR RL RR", holds, dt))
        for part, wanted in zip(got, expected_step(integrator, x, a, dt), strict=True):
            np.testing.assert_allclose(part, wanted, rtol=1e-10, atol=1e-10)


def fall_of(model: WholeBody | SingleRigidBody, x: np.ndarray, dt: float, steps: int) -> float:
    """Return how far the centre of mass is from its parabola after some steps of free flight [m]."""

    def centre(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if isinstance(model, SingleRigidBody):
            return x[:3], x[7:10]
        data = model.robot.model.createData()
        pin.centerOfMass(model.robot.model, data, *to_pinocchio(x))
        return data.com[0].copy(), data.vcom[0].copy()

    (at, v), time = centre(x), dt * steps
    for _ in range(steps):
        if isinstance(model, SingleRigidBody):
            x = model.step(x, np.zeros(12), "", np.zeros((4, 3)), dt)
        else:
            x = model.step(x, np.zeros(model.robot.num_joints), "", dt)
    return float(np.linalg.norm(centre(x)[0] - (at + v * time + 0.5 * GRAVITY * time**2)))


def test_a_rigid_body_flies_on_its_parabola_while_it_turns() -> None:
    start = {"linear_velocity": (1.0, 0.3, 2.0), "angular_velocity": (3.0, -2.0, 5.0)}
    exact, first_order = (SingleRigidBody(load("mini_cheetah"), integrator=kind) for kind in ("midpoint", "euler"))
    assert fall_of(exact, exact.state(**start), dt=0.05, steps=4) < 1e-14
    assert fall_of(first_order, first_order.state(**start), dt=0.05, steps=4) == pytest.approx(0.049, abs=1e-3)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_whole_body_that_does_not_turn_flies_on_its_parabola(name: str) -> None:
    start = {"joints": "stand", "rpy": (0.3, -0.2, 0.5), "linear_velocity": (1.0, 0.3, 2.0)}
    exact, first_order = (WholeBody(load(name), integrator=kind) for kind in ("midpoint", "euler"))
    assert fall_of(exact, exact.state(**start), dt=0.02, steps=10) < 1e-12
    assert fall_of(first_order, first_order.state(**start), dt=0.02, steps=10) == pytest.approx(0.01962, abs=1e-4)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_tumbling_robot_comes_to_its_parabola_at_second_order(name: str) -> None:
    """It turns at 15 rad/s, its legs fly about; Pinocchio says where the centre of mass is, and how fast."""
    body = WholeBody(load(name))
    start = body.state(
        joints="crouch", linear_velocity=(0, -1, 1.5), angular_velocity=(15.0, 0.5, -0.5),
        joint_velocities=np.tile([0.5, -2.0, 3.0], 4),
    )  # fmt: skip
    coarse, fine = (fall_of(body, start, 0.4 / steps, steps) for steps in (40, 80))
    assert coarse < 4e-3
    assert coarse / fine == pytest.approx(4.0, rel=0.1)


def sway(body: WholeBody, dt: float, seconds: float = 4.0) -> tuple[float, float]:
    """Let a robot sway on all its feet; return how far a foot and the base went from their places [m].

    The base follows a sine by feedback on its acceleration, through the torques at which the robot stands.
    """
    state, names, num_joints = body.state, " ".join(body.robot.foot_names), body.robot.num_joints
    start = x = state(joints="stand")
    feet, still, drift, far = body.foot_positions(x), np.zeros(num_joints), 0.0, 0.0

    def acceleration(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return body.acceleration(x, u, names)[:6]

    by_torque = np.column_stack([acceleration(x, e) - acceleration(x, still) for e in np.eye(num_joints)])
    torque = np.linalg.pinv(by_torque)
    hold = -torque @ acceleration(x, still)
    for t in dt * np.arange(round(seconds / dt)):
        there = min(t, 1.0) * np.sin(5 * t) * np.array([0.01, 0.04, -0.015, 0.1, 0.05, 0.15])
        error = state.np_minus(x, state.np_plus(start, np.r_[there, np.zeros(state.ndx - 6)]))
        wanted = -60 * error[:6] - 12 * x[body.nq : body.nq + 6]
        x = body.step(x, hold + torque @ (wanted - acceleration(x, hold)), names, dt)
        drift = max(drift, float(np.linalg.norm(body.foot_positions(x) - feet, axis=1).max()))
        far = max(far, float(np.linalg.norm(x[:2] - start[:2])))
    return drift, far


@pytest.mark.parametrize("name", ROBOTS)
def test_feet_keep_their_places_while_the_robot_sways(name: str) -> None:
    body = WholeBody(load(name))
    for dt in (0.02, 0.01):
        drift, far = sway(body, dt)
        assert drift <= 1e-3
        assert far > 0.03


def test_other_steps_let_feet_drift_while_the_robot_sways() -> None:
    for kind in ("euler", "semi_implicit"):
        assert sway(WholeBody(load("mini_cheetah"), integrator=kind), 0.01)[0] > 4e-3


def test_midpoint_is_the_default_and_files_tell_it() -> None:
    for model in (WholeBody, SingleRigidBody):
        assert model(load("solo12")).recipe()["integrator"] == "midpoint"
        assert model(load("solo12"), integrator="euler").recipe()["integrator"] == "euler"


def test_unknown_integrators_are_refused() -> None:
    robot = load("mini_cheetah")
    with pytest.raises(ModelError, match="got 'rk4', expected 'euler', 'semi_implicit' or 'midpoint'; choose one"):
        WholeBody(robot, integrator="rk4")  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="rigid body of 'mini_cheetah': unknown integrator - got 'semi_implicit'"):
        SingleRigidBody(robot, integrator="semi_implicit")


@pytest.mark.parametrize(("integrator", "count"), [("euler", 2), ("semi_implicit", 1), ("midpoint", 1)])
def test_a_foot_depends_on_its_stance_for_as_many_nodes_as_the_step_says(integrator: Integrator, count: int) -> None:
    body, flight = WholeBody(load("solo12"), integrator=integrator), stance("")
    nodes = [Node(0.0, flight, None, {}, previous_mode=stance("FL HR"), steps=k) for k in range(4)]
    flags = [body.node_parameters(node)["lifting"].tolist() for node in nodes]
    assert flags == [[1, 0, 0, 1]] * count + [[0, 0, 0, 0]] * (4 - count)
