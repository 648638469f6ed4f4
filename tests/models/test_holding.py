"""The initial guess of the controls: forces and torques with which a robot stands still on its feet."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.models import SingleRigidBody, WholeBody, base, feet, joints, load, stance
from piaffe.models.holding import Holding, holding_forces
from tests.robots import ROBOTS

BIPED = Path(__file__).parents[2] / "examples" / "biped.urdf"
CORNERS = [f"{side}_{end}_{edge}" for side in "LR" for end in ("TOE", "HEEL") for edge in ("IN", "OUT")]


def guess(body: WholeBody | SingleRigidBody, states: np.ndarray, contact: np.ndarray, **slots: object) -> np.ndarray:
    """Return a model's controls for states at rest, (N, nu), with a last node that has no stage."""
    p = {name: np.tile(value, (len(states), 1)) for name, value in body.numbers(**slots).items()}
    p |= {"contact": contact, "dt": np.full((len(states), 1), 0.01)}
    nodes = [ocp.Node(0.0, None, None, {})] * len(states)
    (values,) = body.control_guess(nodes, np.vstack([states, states[-1:]]), p).values()
    return values


def postures(body: WholeBody, count: int, spread: float = 0.1) -> np.ndarray:
    """Return states at rest near the standing one, (count, nx)."""
    rng, stand = np.random.default_rng(3), body.robot.pose("stand")
    return np.array([
        body.state(rpy=rng.normal(scale=spread, size=3), joints=stand + rng.normal(scale=spread, size=len(stand)))
        for _ in range(count)
    ])  # fmt: skip


@pytest.mark.parametrize("name", ROBOTS)
def test_the_torques_of_a_standing_robot_leave_no_acceleration(name: str) -> None:
    body = WholeBody(load(name))
    every, states = stance(roles="all"), [body.state(joints="stand"), *postures(body, 3)]
    for x in states:
        u = guess(body, x[None], np.ones((1, 4)))[0]
        assert np.all(np.abs(u) < body.robot.torque_limit)
        np.testing.assert_allclose(body.acceleration(x, u, every), 0.0, atol=1e-6)
        assert body.contact_forces(x, u, every)[:, 2].min() > 0


@pytest.mark.parametrize("name", ROBOTS)
def test_on_two_feet_the_base_does_not_fall(name: str) -> None:
    body = WholeBody(load(name))
    x, diagonal = body.state(joints="stand"), [body.robot.foot_names[i] for i in (0, 3)]
    u = guess(body, x[None], np.array([[1.0, 0.0, 0.0, 1.0]]))[0]
    assert np.linalg.norm(body.acceleration(x, np.zeros(12), " ".join(diagonal))[:3]) > 9.0
    assert np.linalg.norm(body.acceleration(x, u, " ".join(diagonal))[:3]) < 0.1


def test_forces_are_the_smallest_that_give_the_wrench_or_come_nearest() -> None:
    rng, arms = np.random.default_rng(0), np.array([[0.2, 0.1], [0.2, -0.1], [-0.2, 0.1], [-0.2, -0.1]])
    contact = np.array([[1, 1, 1, 1], [1, 0, 0, 1], [0, 1, 1, 1], [0, 0, 1, 0], [0, 0, 0, 0]], dtype=float)
    places = np.concatenate([arms + 0.02 * rng.normal(size=(5, 4, 2)), np.full((5, 4, 1), -0.3)], axis=2)
    maps = np.concatenate([np.tile(np.eye(3), (5, 1, 4)), np.zeros((5, 3, 12))], axis=1)
    for axis, unit in enumerate(np.eye(3)):
        maps[:, 3:, axis::3] = np.cross(places, unit).swapaxes(1, 2)
    wrench = np.array([1.0, -2.0, 90.0, 0.2, -0.1, 0.3]) + 0.1 * rng.normal(size=(5, 6))
    forces = holding_forces(maps, contact, wrench)
    for F, G, w, on in zip(forces, maps, wrench, np.repeat(contact, 3, axis=1), strict=True):
        np.testing.assert_allclose(F, np.linalg.pinv(G * on, rcond=1e-9) @ w, atol=1e-5)
    np.testing.assert_allclose(np.einsum("ij,j->i", maps[0], forces[0]), wrench[0], atol=1e-8)


def test_a_robot_without_feet_has_no_forces() -> None:
    assert holding_forces(np.zeros((2, 6, 0)), np.zeros((2, 0)), np.ones((2, 6))).shape == (2, 0)


def test_no_foot_pulls() -> None:
    model = SingleRigidBody(load("mini_cheetah"))
    ahead = np.array([[0.3, 0.1, 0.0], [0.3, -0.1, 0.0], [0.1, 0.1, 0.0], [0.1, -0.1, 0.0]])  # none below the body
    pulled = guess(model, model.state()[None], np.ones((1, 4)), footholds=ahead)[0].reshape(4, 3)
    assert pulled[:, 2].min() >= 0
    assert pulled[:, 2].max() > 10
    np.testing.assert_array_equal(pulled[:2], 0.0)


def test_the_foot_that_pulls_most_is_taken_out_first() -> None:
    places = np.array([[0.1, -0.1, -0.3], [-0.2, 0.1, -0.3], [0.3, -0.3, -0.3], [-0.2, 0.3, -0.3]])
    maps = np.concatenate([np.tile(np.eye(3), 4), np.zeros((3, 12))])
    for axis, unit in enumerate(np.eye(3)):
        maps[3:, axis::3] = np.cross(places, unit).T
    wrench = np.array([0.0, 0.0, 90.0, -10.0, 20.0, 0.0])
    with_all = (np.linalg.pinv(maps, rcond=1e-9) @ wrench)[2::3]
    assert with_all[3] < with_all[2] < 0  # two feet would pull; without the last one, the other pushes
    vertical = holding_forces(maps[None], np.ones((1, 4)), wrench[None])[0, 2::3]
    assert vertical[2] > 10
    assert vertical[3] == 0


def test_torques_are_zero_in_flight() -> None:
    body = WholeBody(load("solo12"))
    states, contact = postures(body, 3), np.array([[1.0] * 4, [0.0] * 4, [1.0] * 4])
    np.testing.assert_array_equal(guess(body, states, contact).any(axis=1), [True, False, True])
    assert not guess(body, states, np.zeros((3, 4))).any()


def test_torques_stay_within_their_limits() -> None:
    robot = load("mini_cheetah")
    x, every = WholeBody(robot).state(joints="stand"), np.ones((1, 4))
    free = guess(WholeBody(robot), x[None], every)[0]
    limit = np.full(12, 0.5 * np.abs(free).max())
    np.testing.assert_allclose(
        guess(WholeBody(replace(robot, torque_limit=limit)), x[None], every)[0], np.clip(free, -limit, limit)
    )


@pytest.mark.parametrize("damping", [1e-6, 1e-4])
def test_a_biped_with_redundant_contact_points_stands(damping: float) -> None:
    body = WholeBody(load(BIPED, feet=CORNERS), contact_damping=damping)
    x = body.state(joints="stand")
    u = guess(body, x[None], np.ones((1, 8)))[0]
    every = " ".join(CORNERS)
    weight = body.robot.mass * 9.81
    acceleration = body.acceleration(x, u, every)
    assert np.abs(acceleration[:3]).max() < 3 * damping * weight  # the compliance of the contacts gives way so much
    assert body.contact_forces(x, u, every)[:, 2].sum() == pytest.approx(weight, rel=100 * damping)


def test_nodes_in_one_call_are_those_of_one_call_each() -> None:
    body = WholeBody(load("go2"))
    states = np.repeat(postures(body, 4), [3, 1, 2, 3], axis=0)
    contact = np.array([[1, 1, 1, 1], [1, 1, 1, 1], [1, 0, 0, 1], [0, 0, 0, 0], [1, 1, 1, 1], [0, 1, 1, 0], [1] * 4,
                        [1] * 4, [1] * 4], dtype=float)  # fmt: skip
    together = guess(body, states, contact)
    alone = [guess(body, x[None], on[None])[0] for x, on in zip(states, contact, strict=True)]
    np.testing.assert_allclose(together, alone, rtol=1e-9, atol=1e-9)


def test_equal_nodes_in_a_row_are_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    body, sizes = WholeBody(load("solo12")), []

    def counted(maps: np.ndarray, contact: np.ndarray, wrench: np.ndarray, length: float) -> np.ndarray:
        sizes.append(len(maps))
        return holding_forces(maps, contact, wrench, length)

    monkeypatch.setattr("piaffe.models.holding.holding_forces", counted)
    guess(body, np.repeat(postures(body, 2), 50, axis=0), np.ones((100, 4)))
    assert sizes == [2]


def test_the_load_is_the_inverse_dynamics_at_rest_and_changes_with_its_parameters() -> None:
    body = WholeBody(load("anymal_c"))
    x, every = postures(body, 1, spread=0.3)[0], np.ones((1, 4))
    heavier = {"link_mass": 1.5 * body.numbers()["link_mass"], "gravity": np.array([0.5, 0.0, -9.0])}
    slots = {name: value[None] for name, value in body.numbers(**heavier).items()}
    inputs = (x[None, :19], slots["gravity"], slots["link_mass"], slots["link_com"])
    load_at_rest, jacobian = Holding(body.tree, body.contacts)._function(*inputs)
    np.testing.assert_allclose(load_at_rest[0], body.bias(x, **heavier), atol=1e-9)
    np.testing.assert_allclose(jacobian[0], body.contact_jacobian(x), atol=1e-12)
    u = guess(body, x[None], every, **heavier)[0]
    np.testing.assert_allclose(body.acceleration(x, u, " ".join(body.robot.foot_names), **heavier), 0, atol=1e-6)


def test_the_forces_of_a_rigid_body_are_its_controls() -> None:
    model = SingleRigidBody(load("mini_cheetah"))
    nodes = ocp.Node(0.0, None, None, {base.position: np.array([0.3, 0.1, 0.3]), base.orientation: np.eye(4)[0]})
    places = model.node_parameters(replace(nodes, mode=model.resolve("FL FR HL HR")))["footholds"]
    x = model.state(position=(0.3, 0.1, 0.3))
    u = guess(model, x[None], np.ones((1, 4)), footholds=places)[0]
    after = model.step(x, u, "FL FR HL HR", places, 0.01)
    np.testing.assert_allclose(after, x, atol=1e-9)
    lifted = guess(model, x[None], np.array([[1.0, 0.0, 0.0, 1.0]]), footholds=places)[0].reshape(4, 3)
    np.testing.assert_array_equal(lifted[1:3], 0.0)
    assert lifted[:, 2].sum() == pytest.approx(model.numbers()["mass"][0] * 9.81, rel=1e-2)


# ---- in a problem


def standing(body: ocp.ModelBase, nodes: int, **targets: object) -> ocp.Problem:
    """Return the problem of a Mini Cheetah that stands still."""
    motion = ocp.Motion(
        ocp.Phase("stand", stance("FL FR HL HR"), 0.01 * nodes, ocp.Keyframe(joints="stand", **targets))
    )
    objective = ocp.Objective(
        ocp.track(base.position, weight=(1, 1, 10)), ocp.track(base.orientation, weight=2.0),
        ocp.track(base.linear_velocity, weight=0.5), ocp.track(base.angular_velocity, weight=0.1),
        ocp.track(joints.position, weight=0.5), ocp.track(joints.velocity, weight=0.05),
        ocp.regularize(joints.torque, weight=0.02),
    )  # fmt: skip
    limits = ocp.Constraints(models.friction_cone(0.6), models.torque_limits(), models.joint_limits())
    return ocp.Problem(motion, body.until_end(dt=0.01), objective, limits, initial=body.state(joints="stand"))


def test_the_guess_follows_contacts_that_change_within_a_phase_of_a_rigid_body() -> None:
    body = SingleRigidBody(load("mini_cheetah"))
    motion = ocp.Motion(*(ocp.Phase(names, stance(names), 0.1) for names in ("FL FR HL HR", "FL HR")))
    objective = ocp.Objective(ocp.regularize(feet.force, weight=1e-3))
    (phase,) = ocp.compile_problem(ocp.Problem(motion, body.until_end(dt=0.05), objective, initial=body.state())).phases
    vertical = phase.guess_controls.reshape(4, 4, 3)[:, :, 2] > 1.0
    np.testing.assert_array_equal(vertical, [[1, 1, 1, 1]] * 2 + [[1, 0, 0, 1]] * 2)


def test_standing_still_for_ten_seconds_converges() -> None:
    body = WholeBody(load("mini_cheetah"))
    solution = solvers.MSiLQR(standing(body, 1000)).solve()
    assert solution.status is solvers.Status.CONVERGED
    assert solution.iterations <= 20
    np.testing.assert_allclose(solution.states[:, :3], np.tile(solution.states[0, :3], (1001, 1)), atol=0.05)


def test_torques_of_the_path_are_kept() -> None:
    body, given = WholeBody(load("mini_cheetah")), np.linspace(-1, 1, 12)
    held = ocp.compile_problem(standing(body, 4)).phases[0].guess_controls
    assert np.abs(held).max() > 1.0
    path = ocp.compile_problem(standing(body, 4, **{"joints.torque": given})).phases[0].guess_controls
    np.testing.assert_allclose(path, np.outer([0.0, 0.25, 0.5, 0.75], given))  # a path begins at zero


def test_the_forces_of_a_gait_are_kept_by_a_rigid_body() -> None:
    model = SingleRigidBody(load("mini_cheetah"))
    objective = ocp.Objective(ocp.track(base.position), ocp.track(feet.force, weight=0.01))
    trot = models.gaits.trot(speed=0.3)
    problem = ocp.Problem(trot, model.over(0.3, dt=0.05), objective, initial=model.state())
    for phase in ocp.compile_problem(problem).phases:
        for k, t in enumerate(phase.times[:-1]):
            assert phase.guess_controls[k, 2::3].sum() == pytest.approx(model.robot.mass * 9.81, rel=1e-6), t
