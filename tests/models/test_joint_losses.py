"""Damping and dry friction of joints: against closed forms, a fine integration, Pinocchio's terms and MuJoCo."""

from collections.abc import Callable
from dataclasses import replace

import casadi as cs
import mujoco
import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ModelError, ProblemError, SolverError
from piaffe.models import Robot, WholeBody, stance
from piaffe.models.integrators import INTEGRATORS, Integrator
from piaffe.models.joint_losses import loss_torque
from piaffe.solvers.tracking.slots import slot_changes
from tests.robots import ROBOTS

from .test_whole_body import Oracle, random_state, rows_of, solve_contact

DAMPING = np.tile([0.05, 0.1, 0.2], 4)
FRICTION = np.tile([0.2, 0.4, 1.0], 4)
SPEED = 0.3  # the default


def lossy(name: str = "mini_cheetah", *, rotors: bool = False, scale: float = 1.0) -> Robot:
    return models.load(name, rotors=rotors, joint_damping=scale * DAMPING, joint_friction=scale * FRICTION)


def rubbing(v: np.ndarray, speed: float = SPEED) -> np.ndarray:
    """Return the torque of damping and dry friction at a velocity of the joints."""
    return np.asarray(DAMPING * v + FRICTION * v / np.hypot(v, speed))


def torque(v: object, a: object, dt: float, **numbers: float) -> np.ndarray:
    slots = {"joint_damping": 0.0, "joint_friction": 0.0, "armature": 0.0, "friction_speed": SPEED, **numbers}
    loss = loss_torque(cs.SX(v), cs.SX(a), cs.SX(dt), {name: cs.SX(number) for name, number in slots.items()})
    return np.asarray(cs.evalf(loss)).ravel()


def coasting(v: float, dt: float, inertia: float, **numbers: float) -> float:
    """Return the velocity after a step of one joint that nothing else moves, inertia a + τ(v, a) = 0."""
    still, slope = (torque(v, a, dt, **numbers)[0] for a in (0.0, 1.0))
    return float(v - dt * still / (inertia + slope - still))


# ---- the torque


def test_without_a_step_the_torque_is_that_of_the_velocity() -> None:
    v = np.array([-4.0, -0.3, 0.0, 0.3, 20.0])
    got = torque(v, 100.0 * np.ones(5), 0.0, joint_damping=0.1, joint_friction=2.0)
    np.testing.assert_allclose(got, 0.1 * v + 2.0 * v / np.hypot(v, SPEED), rtol=1e-14)
    assert got[3] == pytest.approx(0.03 + 2.0 / np.sqrt(2))


def test_without_damping_and_friction_there_is_no_torque() -> None:
    assert not np.any(torque(np.array([-4.0, 0.0, 3.0]), np.array([1.0, 200.0, -5.0]), 0.01))


def test_damping_acts_at_the_mean_velocity_of_a_step() -> None:
    v, a, dt = np.array([1.0, -2.0]), np.array([50.0, 30.0]), 0.01
    np.testing.assert_allclose(torque(v, a, dt, joint_damping=0.4), 0.4 * (v + 0.5 * a * dt), rtol=1e-14)


def test_a_step_never_makes_a_joint_faster() -> None:
    rng = np.random.default_rng(0)
    for _ in range(2000):
        armature, rest, damping, friction, dt = 10.0 ** rng.uniform([-5, -5, -3, -2, -3], [-1, 0, 1, 1, -1.3])
        v, armature = 10 * rng.normal(), armature * rng.integers(2)
        numbers = {"joint_damping": damping, "joint_friction": friction, "armature": armature}
        assert abs(coasting(v, dt, armature + rest, **numbers)) <= abs(v)


def test_a_light_joint_with_dry_friction_comes_to_rest() -> None:
    """Where f is taken at the start of a step, this joint swings between ± 1.8 rad/s."""
    v = 5.0
    for _ in range(60):
        v = coasting(v, 0.01, 5e-4, joint_friction=0.2)
    assert abs(v) < 0.05


def test_friction_of_a_step_is_of_second_order_with_a_rotor() -> None:
    def end(steps: int) -> float:
        v, dt = 3.0, 0.1 / steps
        for _ in range(steps):
            v = coasting(v, dt, 0.02, joint_friction=0.4, joint_damping=0.05, armature=0.015)
        return v

    exact = end(20000)
    errors = [abs(end(steps) - exact) for steps in (20, 40, 80)]
    assert errors[0] < 5e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


# ---- the whole body


@pytest.mark.parametrize("name", ROBOTS)
def test_losses_are_torques_against_the_motion(name: str) -> None:
    body, rng = WholeBody(lossy(name), friction_speed=SPEED), np.random.default_rng(1)
    standing = body.robot.foot_names[::3]
    rows = rows_of(body.robot.foot_names, standing)
    for feet, chosen in (("", rows[:0]), (" ".join(standing), rows)):
        for _ in range(5):
            x, u = random_state(body, rng), rng.normal(size=12)
            expected, force = solve_contact(Oracle(body.robot, x), u - rubbing(x[-12:]), chosen, gamma=20.0)
            got = body.acceleration(x, u, feet, gamma=20.0)
            np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
            stands = body.contact_forces(x, u, feet, gamma=20.0).ravel()[chosen]
            np.testing.assert_allclose(stands, force, atol=1e-8 * max(1.0, np.abs(force).max(initial=0.0)))


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_step_is_that_without_losses_and_with_their_torque(integrator: Integrator) -> None:
    robot, dt = lossy(rotors=True), 0.01
    free = replace(robot, joint_damping=np.zeros(12), joint_friction=np.zeros(12))
    body, plain = (WholeBody(each, integrator=integrator) for each in (robot, free))
    rng = np.random.default_rng(2)
    for _ in range(5):
        x, u = random_state(body, rng), rng.normal(size=12)
        after = body.step(x, u, "FL HR", dt)
        v, v_next = x[-12:], after[-12:]
        root = np.hypot(v, SPEED)
        secant, tangent = FRICTION / root, FRICTION * SPEED**2 / root**3
        share = secant * dt / (secant * dt + 2 * robot.armature)
        half = 0.5 * (v_next - v)
        loss = DAMPING * (v + half) + secant * v + (tangent + share * (secant - tangent)) * half
        np.testing.assert_allclose(plain.step(x, u - loss, "FL HR", dt), after, rtol=1e-6, atol=1e-6)
        assert np.abs(plain.step(x, u, "FL HR", dt) - after).max() > 1e-2


def swing(t: float) -> np.ndarray:
    """Return torques that swing the legs of a flying robot."""
    return np.asarray(np.tile([0.3, -0.6, 1.6], 4) * np.sin(25 * t + np.arange(12)))


def fly(step: Callable[[np.ndarray, float, float], np.ndarray], x: np.ndarray, seconds: float, dt: float) -> np.ndarray:
    for k in range(round(seconds / dt)):
        x = step(x, (k + 0.5) * dt, dt)
    return x


def start_of(body: WholeBody) -> np.ndarray:
    return body.state(joints="crouch", joint_velocities=np.tile([0.5, -2.0, 3.0], 4))


def test_steps_come_to_a_fine_integration_at_second_order() -> None:
    """The fine one is Runge and Kutta's, with the continuous dynamics."""
    body = WholeBody(lossy(rotors=True))

    def runge_kutta(x: np.ndarray, t: float, dt: float) -> np.ndarray:
        def rate(at: np.ndarray, t: float) -> np.ndarray:
            return np.concatenate([at[body.nq :], body.acceleration(at, swing(t), "")])

        first = rate(x, t - dt / 2)
        second = rate(body.state.np_plus(x, dt / 2 * first), t)
        third = rate(body.state.np_plus(x, dt / 2 * second), t)
        last = rate(body.state.np_plus(x, dt * third), t + dt / 2)
        return body.state.np_plus(x, dt / 6 * (first + 2 * second + 2 * third + last))

    def step(x: np.ndarray, t: float, dt: float) -> np.ndarray:
        return body.step(x, swing(t), "", dt)

    start = start_of(body)
    exact = fly(runge_kutta, start, 0.12, 0.0005)
    errors = [np.abs(body.state.np_minus(fly(step, start, 0.12, dt), exact)[18:]).max() for dt in (0.004, 0.002, 0.001)]
    assert errors[1] < 0.05
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.3)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.2)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_large_damping_of_light_joints_is_stable(integrator: Integrator) -> None:
    """At the start of a step it would be multiplied by 1 − 200 in each."""
    robot = replace(lossy(), joint_damping=np.full(12, 5.0), joint_friction=np.full(12, 5.0))
    body = WholeBody(robot, integrator=integrator)
    x, fastest = start_of(body), []
    for _ in range(100):
        x = body.step(x, np.zeros(12), "", 0.02, gravity=(0, 0, 0))
        fastest.append(np.abs(x[-12:]).max())
    assert max(fastest) <= 3.0
    assert fastest[-1] < 1.0


def test_impacts_have_no_losses() -> None:
    body, plain, rng = WholeBody(lossy()), WholeBody(models.load("mini_cheetah")), np.random.default_rng(3)
    x = random_state(body, rng)
    np.testing.assert_array_equal(body.impact(x, "FL HR"), plain.impact(x, "FL HR"))


def test_parameters_change_losses_by_name() -> None:
    plain, robot = WholeBody(models.load("solo12")), lossy("solo12", scale=0.1)
    body = WholeBody(robot, friction_speed=0.5)
    objective = ocp.Objective(ocp.regularize("joints.torque"))
    motion = ocp.Motion(ocp.Phase("flight", stance(""), 0.04, {"joints": "crouch"}))
    numbers = {
        "solo12.joint_damping": 0.1 * DAMPING, "solo12.joint_friction": 0.1 * FRICTION, "solo12.friction_speed": 0.5,
    }  # fmt: skip

    def problem(model: WholeBody) -> ocp.Problem:
        return ocp.Problem(motion, model.until_end(dt=0.02), objective, initial=start_of(model))

    changed, declared = problem(plain).with_parameters(numbers), problem(body)
    for one in (ocp.compile_problem(changed), ocp.compile_problem(problem(plain)).with_parameters(numbers)):
        np.testing.assert_array_equal(one.phases[0].p, ocp.compile_problem(declared).phases[0].p)
    x, u = start_of(body), np.ones(12)
    given = {"joint_damping": 0.1 * DAMPING, "joint_friction": 0.1 * FRICTION, "friction_speed": 0.5}
    np.testing.assert_array_equal(plain.step(x, u, "", 0.01, **given), body.step(x, u, "", 0.01))


@pytest.mark.parametrize("speed", [0.0, -1.0])
def test_a_friction_speed_out_of_range_is_refused_as_a_parameter_too(speed: float) -> None:
    body = WholeBody(models.load("solo12"))
    motion = ocp.Motion(ocp.Phase("flight", stance(""), 0.04, {"joints": "crouch"}))
    objective = ocp.Objective(ocp.regularize("joints.torque"))
    problem = ocp.Problem(motion, body.until_end(dt=0.02), objective, initial=start_of(body))
    number, compiled = {"solo12.friction_speed": speed}, ocp.compile_problem(problem)
    text = rf"parameter 'solo12.friction_speed': is out of range - got \[{speed}\], expected numbers > 0"
    for change in (problem.with_parameters, compiled.with_parameters):
        with pytest.raises(ProblemError, match=text):
            change(number)
    text = r"slot 'friction_speed': is out of range - got \[0.0\], expected numbers > 0"
    with pytest.raises(SolverError, match=text):
        slot_changes(compiled.phases[0].mode, {"friction_speed": 0.0})


@pytest.mark.parametrize("speed", [0.0, -1.0, np.inf, "slow"])
def test_a_friction_speed_out_of_range_is_refused(speed: object) -> None:
    with pytest.raises(ModelError, match=r"friction_speed is out of range - got .*, expected a finite number > 0"):
        WholeBody(models.load("solo12"), friction_speed=speed)  # type: ignore[arg-type]


# ---- MuJoCo


def in_the_air(robot: Robot, dt: float) -> mujoco.MjModel:
    model = models.mujoco_model(robot, contacts="none", joint_limits=False, visuals=False, dt=dt)
    model.opt.tolerance = 1e-14
    return model


@pytest.mark.parametrize("name", ROBOTS)
def test_acceleration_of_moving_joints_is_mujoco_s(name: str) -> None:
    robot = lossy(name)
    body, model, rng = WholeBody(robot, friction_speed=1e-5), in_the_air(robot, 1e-5), np.random.default_rng(4)
    model.dof_solref[:] = (1e-4, 1.0)  # a joint slides unless friction can stop it in this time
    data = mujoco.MjData(model)
    for _ in range(5):
        x, u = random_state(body, rng), rng.uniform(-1, 1, 12) * np.minimum(robot.torque_limit, 2.0)
        x[-12:] += 3.0 * np.sign(x[-12:])
        data.qpos[:], data.qvel[:], data.ctrl[:] = x[: body.nq], x[body.nq :], u
        mujoco.mj_forward(model, data)
        got = body.acceleration(x, u, "")
        assert np.max(np.abs(got - data.qacc)) < 1e-6 * np.max(np.abs(data.qacc))


def test_steps_of_a_plan_follow_mujoco() -> None:
    """Legs swing for 0.2 s with torques to which losses matter; MuJoCo takes 100 steps for one of the plan."""
    robot = replace(lossy(rotors=True, scale=0.4))
    model = in_the_air(robot, 1e-4)
    data, body, plain = mujoco.MjData(model), WholeBody(robot), WholeBody(models.load("mini_cheetah", rotors=True))
    x = y = start_of(body)
    data.qpos[:], data.qvel[:] = x[: body.nq], x[body.nq :]
    apart, without, way = 0.0, 0.0, 0.0
    for k in range(20):
        data.ctrl[:] = u = swing((k + 0.5) * 0.01)
        for _ in range(100):
            mujoco.mj_step(model, data)
        x, y = body.step(x, u, "", 0.01), plain.step(y, u, "", 0.01)
        apart = max(apart, np.abs(x[7:19] - data.qpos[7:]).max())
        without = max(without, np.abs(y[7:19] - data.qpos[7:]).max())
        way = max(way, np.abs(data.qpos[7:] - start_of(body)[7:19]).max())
    assert way > 0.3
    assert apart < 0.1 * way
    assert without > 5 * apart
