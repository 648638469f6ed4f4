"""The hybrid kinodynamic model: the body is the single rigid body's, feet stand, legs in the air follow commands."""

from pathlib import Path

import casadi as cs
import numpy as np
import pytest

from piaffe import ocp, solvers
from piaffe.errors import ModelError, ShapeError
from piaffe.models import (
    HybridKinodynamic,
    SingleRigidBody,
    WholeBody,
    base,
    feet,
    foot_clearance,
    friction_cone,
    gaits,
    joints,
    load,
    stance,
)
from piaffe.models.integrators import Integrator
from tests import urdf

ROBOT = load("mini_cheetah")
PUSH = np.tile([5.0, 3.0, 20.0], 4)  # [N]
TURN = np.random.default_rng(4).normal(size=12)  # [rad/s]


@pytest.fixture(scope="module")
def model() -> HybridKinodynamic:
    return HybridKinodynamic(ROBOT)


def moving(model: HybridKinodynamic) -> np.ndarray:
    return model.state(
        joints="stand", rpy=(0.2, -0.1, 0.5), linear_velocity=(0.5, 0.2, 0.3), angular_velocity=(3, 2, -1)
    )


def places(model: HybridKinodynamic, x: np.ndarray) -> np.ndarray:
    n = model.robot.num_joints
    return model.kinematics.world_feet(x[None, :3], x[None, 3:7], x[None, 7 : 7 + n])[0]


@pytest.mark.parametrize("integrator", ["midpoint", "euler"])
@pytest.mark.parametrize("contacts", ["FL FR HL HR", "FL HR", ""])
def test_the_body_moves_as_a_single_rigid_body_on_the_same_feet(contacts: str, integrator: Integrator) -> None:
    model, rigid = HybridKinodynamic(ROBOT, integrator=integrator), SingleRigidBody(ROBOT, integrator=integrator)
    x = moving(model)
    found = model.step(x, np.concatenate([PUSH, TURN]), contacts, 0.02)
    expected = rigid.step(np.r_[x[:7], x[19:]], PUSH, contacts, places(model, x), 0.02)
    np.testing.assert_allclose(np.r_[found[:7], found[19:]], expected, rtol=1e-12, atol=1e-12)


def test_feet_on_the_ground_stand_with_an_error_of_third_order(model: HybridKinodynamic) -> None:
    slips = []
    for steps in (5, 10):
        x = first = moving(model)
        for _ in range(steps):
            x = model.step(x, np.concatenate([PUSH, TURN]), "FL HR", 0.1 / steps)
        slips.append(np.abs(places(model, x) - places(model, first))[[0, 3]].max())
    assert np.abs(places(model, x) - places(model, first))[[1, 2]].max() > 0.05  # the base has moved
    assert slips[0] < 1e-4
    assert slips[0] / slips[1] > 6.5


def test_legs_in_the_air_follow_their_commands_and_legs_on_the_ground_do_not(model: HybridKinodynamic) -> None:
    x, u = moving(model), np.concatenate([PUSH, TURN])
    after = model.step(x, u, "FL HR", 0.02)
    np.testing.assert_allclose(after[10:16] - x[10:16], 0.02 * TURN[3:9], rtol=1e-12)  # FR and HL
    other = np.concatenate([PUSH, TURN + np.r_[np.ones(3), np.zeros(6), np.ones(3)]])
    np.testing.assert_array_equal(model.step(x, other, "FL HR", 0.02), after)
    pushed = u + np.r_[np.zeros(3), np.ones(6), np.zeros(15)]  # forces of feet in the air
    np.testing.assert_array_equal(model.step(x, pushed, "FL HR", 0.02), after)


def test_joint_velocities_are_those_of_the_step(model: HybridKinodynamic) -> None:
    x, u, p = cs.SX.sym("x", 25), cs.SX.sym("u", 24), model.symbols()
    bound = model.dynamics("contact", x, u, cs.SX(0, 1), p).quantities.bind(joints.velocity)
    rates = cs.Function("rates", [x, u, p["contact"]], [bound.value])
    at, told, dt = moving(model), np.concatenate([PUSH, TURN]), 1e-6
    found = rates(at, told, model.flags("FL HR")).full().ravel()
    np.testing.assert_allclose(found, (model.step(at, told, "FL HR", dt) - at)[7:19] / dt, rtol=1e-4, atol=1e-4)


def test_quantities_of_feet_and_frames_are_those_of_the_whole_body_with_these_joint_velocities(
    model: HybridKinodynamic,
) -> None:
    whole = WholeBody(ROBOT)
    x, u, p = cs.SX.sym("x", 25), cs.SX.sym("u", 24), model.symbols()
    own = model.dynamics("contact", x, u, cs.SX(0, 1), p).quantities
    every, z = cs.SX.sym("all", 37), cs.SX.sym("z", whole.implicit_size("contact"))
    other_p = whole.symbols()
    other = whole.dynamics("contact", every, cs.SX.sym("torque", 12), z, other_p).quantities
    at, told, flags = moving(model), np.concatenate([PUSH, TURN]), model.flags("FL HR")
    names = ("contact", "foot_radius", "terrain")
    paths = ["feet.velocity", "feet.position", "feet.height", "feet.reach", "feet.normal_speed", "joints.velocity"]
    paths += ["frames.HR_KFE.velocity", "base.height"]
    values = cs.Function("own", [x, u, *(p[n] for n in names)], [own.bind(path).value for path in paths])
    found = [each.full().ravel() for each in values(at, told, flags, ROBOT.foot_radius, 0.1)]
    full = np.concatenate([at, found[paths.index("joints.velocity")]])
    given = [every, *(other_p[n] for n in names)]
    values = cs.Function("other", given, [other.bind(path).value for path in paths])
    for path, one, two in zip(paths, found, values(full, flags, ROBOT.foot_radius, 0.1), strict=True):
        np.testing.assert_allclose(one, two.full().ravel(), atol=1e-12, err_msg=path)
    speeds = np.abs(found[0].reshape(4, 3))
    assert speeds[[0, 3]].max() < 1e-3  # the feet stand, but for the damping
    assert speeds[[1, 2]].min() > 0.01


def test_a_straight_leg_has_finite_joint_velocities(model: HybridKinodynamic) -> None:
    up = model.state(joints=np.zeros(12), linear_velocity=(0, 0, 1))  # a standing foot cannot follow
    after = model.step(up, np.zeros(24), "FL FR HL HR", 0.01)
    assert np.all(np.isfinite(after))
    assert np.abs(after[7:19]).max() < 0.5
    assert np.abs(places(model, after) - places(model, up)).max() == pytest.approx(0.01, rel=0.2)


def test_a_leg_of_four_joints_follows_its_commands_as_far_as_its_foot_stands(tmp_path: Path) -> None:
    text = urdf.cart()
    for side in "lr":
        knee = urdf.joint(f"{side}_knee", f"{side}_thigh", f"{side}_shank", xyz="0 0 -0.25")
        more = urdf.link(f"{side}_mid", 0.1, inertia=0.001)
        more += urdf.joint(f"{side}_turn", f"{side}_thigh", f"{side}_mid", axis="0.2 0.9 0.1")
        assert knee in text
        text = text.replace(knee, more + urdf.joint(f"{side}_knee", f"{side}_mid", f"{side}_shank", xyz="0 0 -0.25"))
    file = tmp_path / "four.urdf"
    file.write_text(text)
    model = HybridKinodynamic(load(file, feet=urdf.FEET))
    n = model.robot.num_joints
    bent = np.tile([0.1, -0.4, 0.3, 0.6], 2)
    x = model.state(position=(0, 0, 0.5), joints=bent, linear_velocity=(0.3, 0.1, -0.2))
    told = np.concatenate([np.zeros(6), np.tile([0.0, 1.0, -2.0, 0.5], 2)])
    stood, idle = (model.step(x, u, "l r", 0.01) for u in (told, np.zeros(6 + n)))
    assert np.abs(places(model, stood) - places(model, x)).max() < 1e-5
    assert np.linalg.norm(stood[7 : 7 + n] - idle[7 : 7 + n]) > 1e-3


def test_feet_that_share_a_joint_are_refused(tmp_path: Path) -> None:
    heel = urdf.link("heel") + urdf.joint("l_heel", "l_shank", "heel", kind="fixed", xyz="-0.05 0 -0.24")
    file = tmp_path / "heel.urdf"
    file.write_text(urdf.cart(heel))
    robot = load(file, feet=("l_foot", "heel", "r_foot"))
    with pytest.raises(ModelError, match="two feet share joint 'l_roll' - got feet '.*' and '.*', expected a leg of"):
        HybridKinodynamic(robot)


def test_wrong_arguments_are_refused(model: HybridKinodynamic) -> None:
    with pytest.raises(ShapeError, match="argument 'u': wrong size - got 12 entries, expected 24"):
        model.step(model.state(), np.zeros(12), "FL", 0.01)
    with pytest.raises(ModelError, match="kinodynamic model of .*: unknown integrator - got 'rk4', expected 'euler'"):
        HybridKinodynamic(ROBOT, integrator="rk4")  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="mass is out of range - got -1, expected a positive number"):
        HybridKinodynamic(ROBOT, mass=-1)
    with pytest.raises(
        ModelError, match=r"models\.HybridKinodynamic: not a robot - got 'solo12', expected what models"
    ):
        HybridKinodynamic("solo12")  # type: ignore[arg-type]


def test_the_guess_holds_the_body_and_takes_the_reference_of_legs_in_the_air(model: HybridKinodynamic) -> None:
    sample = {joints.velocity: TURN}
    nodes = [ocp.Node(0.0, stance("FL HR"), None, sample)]
    states = np.tile(model.state(joints="stand"), (2, 1))
    p = {name: np.tile(value, (1, 1)) for name, value in model.numbers(contact=[1, 0, 0, 1]).items()}
    guess = model.control_guess(nodes, states, p)
    np.testing.assert_array_equal(guess[joints.commanded_velocity], [np.r_[np.zeros(3), TURN[3:9], np.zeros(3)]])
    p = {name: np.tile(value, (1, 1)) for name, value in model.numbers(contact=np.ones(4)).items()}
    force = model.control_guess(nodes, states, p)[feet.force][0]
    held = model.step(states[0], np.concatenate([force, np.zeros(12)]), "FL FR HL HR", 0.01)
    assert np.abs(held[19:]).max() < 1e-9


def test_a_trot_is_solved_and_verified(model: HybridKinodynamic) -> None:
    objective = ocp.Objective(
        ocp.track(base.position, weight=(0, 0, 30)),
        ocp.track(base.orientation, weight=4.0),
        ocp.track(base.linear_velocity, weight=1.0),
        ocp.track(base.angular_velocity, weight=0.5),
        ocp.track(joints.position, weight=0.1),
        ocp.track(feet.force, weight=0.001),
        ocp.regularize(joints.commanded_velocity, weight=0.001),
    )
    limits = ocp.Constraints(friction_cone(mu=0.6), foot_clearance())
    trot = gaits.trot(speed=0.5).cycles(1)
    initial = model.state(joints="stand")
    problem = ocp.Problem(trot, model.until_end(dt=0.025), objective, limits, initial=initial)
    solution = solvers.MSiLQR(problem, backend="numpy").solve().raise_if_failed()
    phases = solution.trajectory.phases
    assert [phase.mode for phase in phases] == ["FL FR HL HR", "FL HR", "FR HL"]
    assert phases[1].outputs[joints.velocity].shape == (10, 12)
    height = places(model, phases[1].states[-1])[:, 2]
    np.testing.assert_allclose(height, ROBOT.foot_radius, atol=2e-5)  # two feet stand, two land
    assert places(model, phases[1].states[5])[1, 2] > 0.03
    result = ocp.verify(ocp.compile_problem(problem), solution.trajectory)
    assert result.max_slip < 1e-4
    assert result.max_height < 1e-4
