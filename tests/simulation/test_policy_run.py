"""Policies in simulation, against a loop of ``mj_step`` written here, with MuJoCo's own operations on states."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from piaffe.errors import ModelError, ShapeError
from piaffe.models.mujoco.scene import mujoco_spec, restore_inertias
from piaffe.ocp import Trajectory
from piaffe.simulation import Policy, interpolate, phase_index, run_policy, torque_plant
from tests.simulation.plans import BODY, ROBOT, bow


def scene(dt: float, friction: float) -> Any:
    """Return the simulated robot, put together here."""
    spec = mujoco_spec(ROBOT, contacts="feet", friction=friction, dt=dt)
    spec.option.impratio = 10.0
    for foot in ROBOT.feet:
        geom = spec.geom(foot.name)
        geom.solref, geom.solimp = (max(4 * dt, 2e-3), 1.0), (0.95, 0.99, 0.001, 0.5, 2.0)
    model = spec.compile()
    restore_inertias(model, ROBOT)
    return model


def minus(model: Any, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return x ⊖ y as MuJoCo has it."""
    out = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, out, 1.0, y[: model.nq], x[: model.nq])
    return np.concatenate([out, x[model.nq :] - y[model.nq :]])


def plus(model: Any, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
    """Return x ⊕ dx as MuJoCo has it."""
    q = x[: model.nq].copy()
    mujoco.mj_integratePos(model, q, dx[: model.nv], 1.0)
    return np.concatenate([q, x[model.nq :] + dx[model.nv :]])


def played(trajectory: Trajectory, gains: list[np.ndarray], dt: float, friction: float) -> tuple[np.ndarray, ...]:
    """Return states, the plan's states and controls of a policy, one step of MuJoCo after another."""
    model = scene(dt, friction)
    data = mujoco.MjData(model)
    x = trajectory.phases[0].states[0]
    data.qpos[:], data.qvel[:] = x[: model.nq], x[model.nq :]
    mujoco.mj_forward(model, data)
    states, plans, controls = [], [], []
    for step in range(round(0.2 / dt) + 1):
        t = step * dt
        i = 0 if t < 0.1 - 1e-9 else 1
        part = trajectory.phases[i]
        place = (t - 0.1 * i) / 0.02
        k = min(int(place + 1e-6), 4)
        share = min(max(place - k, 0.0), 1.0)
        plan = plus(model, part.states[k], share * minus(model, part.states[k + 1], part.states[k]))
        x = np.concatenate([data.qpos, data.qvel])
        states.append(x)
        plans.append(plan)
        controls.append(part.controls[k] + gains[i][k] @ minus(model, x, plan))
        data.ctrl[:] = controls[-1]
        mujoco.mj_step(model, data)
    return np.array(states), np.array(plans), np.array(controls)


@pytest.mark.parametrize(("dt", "friction"), [(1e-3, 0.6), (2e-3, 0.3)])
def test_a_run_is_what_mujoco_does_with_the_policy(dt: float, friction: float) -> None:
    trajectory, gains = bow()
    run = run_policy(Policy(trajectory, gains), torque_plant(ROBOT, timestep=dt, friction=friction))
    states, plans, controls = played(trajectory, gains, dt, friction)
    assert run.lost_at is None
    np.testing.assert_allclose(run.times, dt * np.arange(round(0.2 / dt) + 1), atol=1e-12)
    np.testing.assert_allclose(run.states, states, atol=1e-9)
    np.testing.assert_allclose(run.planned, plans, atol=1e-12)
    np.testing.assert_array_equal(run.phases, np.arange(len(states)) >= round(0.1 / dt))
    np.testing.assert_allclose(run.position, np.linalg.norm(states[:, :3] - plans[:, :3], axis=1), atol=1e-9)
    full = np.any(np.abs(controls) >= ROBOT.torque_limit, axis=1)
    assert run.saturated == pytest.approx(full.mean())
    assert np.ptp(states[:, 7:19], axis=0).max() > 0.05  # it moved


def test_forces_change_the_momentum_of_the_whole_robot() -> None:
    dt = 1.25e-4  # a step keeps momentum to the first order in dt
    run = run_policy(Policy(*bow()), torque_plant(ROBOT, timestep=dt))
    model = scene(dt, 0.6)
    data = mujoco.MjData(model)
    speed = []
    for x in (run.states[0], run.states[-1]):
        data.qpos[:], data.qvel[:] = x[: model.nq], x[model.nq :]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        speed.append(data.subtree_linvel[0].copy())
    weight = np.array([0.0, 0.0, ROBOT.mass * 9.81])
    impulse = dt * (run.forces[1:].sum(axis=(0, 1)) - len(run.forces[1:]) * weight)
    np.testing.assert_allclose(impulse, ROBOT.mass * (speed[1] - speed[0]), atol=0.01 * 0.2 * weight[2])
    assert run.forces[:, :, 2].min() >= 0.0
    assert np.abs(run.forces[..., :2]).max() > 1.0  # they are in the world's axes, not along the contact's normal


def test_a_plan_without_torque_and_gains_is_lost_or_further_off() -> None:
    trajectory, gains = bow()
    limp = Trajectory(tuple(replace(part, controls=np.zeros((5, 12))) for part in trajectory.phases))
    run = run_policy(Policy(limp, [0 * table for table in gains]), torque_plant(ROBOT))
    held = run_policy(Policy(trajectory, gains), torque_plant(ROBOT))
    assert run.position.max() > 3 * held.position.max()


def test_what_is_far_from_the_plan_is_lost() -> None:
    trajectory, gains = bow()
    far = [part.states + np.r_[0.31 * i, np.zeros(36)] for i, part in enumerate(trajectory.phases)]
    jump = Trajectory(tuple(replace(part, states=states) for part, states in zip(trajectory.phases, far, strict=True)))
    run = run_policy(Policy(jump, gains), torque_plant(ROBOT))
    assert run.lost_at == pytest.approx(0.1)
    assert len(run.times) == 101
    assert "lost the plan at 0.10 s of 0.20 s; error of the base at most 0.3" in str(run)
    assert "followed the plan to its end, 0.20 s" in str(run_policy(Policy(*bow()), torque_plant(ROBOT)))


def test_a_base_that_is_turned_from_the_plan_is_lost() -> None:
    trajectory, gains = bow()
    policy, turn = Policy(trajectory, gains), np.zeros(36)
    for angle, at_once in ((1.1, True), (0.9, False)):
        turn[5] = angle
        run = run_policy(policy, torque_plant(ROBOT), BODY.state.np_plus(policy.initial, turn))
        assert run.orientation[0] == pytest.approx(angle)
        assert (run.lost_at == 0.0) is at_once


@pytest.mark.parametrize("sign", [-1, 1])
def test_torques_at_both_limits_are_full(sign: int) -> None:
    trajectory, gains = bow()
    table = np.zeros((5, 12))
    table[:, 4] = sign * 2 * ROBOT.torque_limit[4]
    parts = tuple(replace(part, controls=table) for part in trajectory.phases)
    run = run_policy(Policy(Trajectory(parts), [np.zeros_like(each) for each in gains]), torque_plant(ROBOT))
    assert run.saturated == 1.0
    np.testing.assert_array_equal(run.full, np.arange(12) == 4 * np.ones((len(run.times), 1)))


def test_only_phases_of_the_plants_states_are_played() -> None:
    trajectory, gains = bow()
    small = replace(trajectory.phases[1], states=trajectory.phases[1].states[:, :13])

    class Solved:
        phases = tuple(type("Gains", (), {"feedback": table})() for table in gains)

        def __init__(self, *parts: Any) -> None:
            self.trajectory = Trajectory(parts)

    policy = Policy.of(Solved(trajectory.phases[0], small), 37)
    assert policy.trajectory.phases == trajectory.phases[:1]
    assert (policy.start, policy.end) == (0.0, 0.1)
    with pytest.raises(ModelError, match="does not begin with such states - got model 'solo12' with 13 states, expec"):
        Policy.of(Solved(small), 37)


def test_gains_that_do_not_fit_are_refused() -> None:
    trajectory, gains = bow()
    with pytest.raises(ShapeError, match="gains do not fit the trajectory - got those of 1 phases, expected 2"):
        Policy(trajectory, gains[:1])
    with pytest.raises(
        ShapeError, match=r"phase 'turn': gains have the wrong size - got shape \(4, 12, 36\), expected"
    ):
        Policy(trajectory, [gains[0], gains[1][:4]])


def test_a_time_on_a_boundary_belongs_to_the_later_phase() -> None:
    trajectory, _ = bow()
    times = (-1.0, 0.0, 0.1 - 1e-6, 0.1 - 1e-12, 0.1, 0.5)
    assert [phase_index(trajectory, t) for t in times] == [0, 0, 0, 1, 1, 1]
    part = trajectory.phases[1]
    np.testing.assert_allclose(interpolate(part, part.states, 9.0), part.states[-1], atol=1e-15)
    np.testing.assert_allclose(interpolate(part, part.states, 0.11)[:3], part.states[:2, :3].mean(axis=0), atol=1e-12)


def test_a_robot_without_torque_limits_can_be_simulated() -> None:
    limited, free = torque_plant(ROBOT), torque_plant(replace(ROBOT, torque_limit=np.full(ROBOT.num_joints, np.inf)))
    assert np.all(np.isfinite(free.action.half_range))
    assert free.compiled().actuator_forcelimited.tolist() == [0] * ROBOT.num_joints
    assert limited.compiled().actuator_forcelimited.tolist() == [1] * ROBOT.num_joints
