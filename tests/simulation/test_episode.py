"""Episodes of controllers that tick between plans, against a loop of ``mj_step`` written here."""

from collections.abc import Iterator
from math import inf, pi
from typing import Any

import mujoco
import numpy as np
import pytest

from piaffe import models
from piaffe.errors import SamplingError
from piaffe.models import SoftContact
from piaffe.simulation import Judgement, Policy, PolicyController, PolicyPlan, TickingController, run_episode
from tests.simulation.plans import BODY, ROBOT, bow

STEP, PLAN_STEPS = 0.002, 10  # the simulator's step [s], of which so many make one of the planner
STAND = ROBOT.pose("stand")


def plant() -> models.Mujoco:
    return models.Mujoco(
        ROBOT, timestep=STEP, substeps=PLAN_STEPS, action=models.torques(), contact=SoftContact.accurate()
    )


def targets(x: np.ndarray, t: float) -> np.ndarray:
    """Return joint angles to go for: a swing in time that reacts to the measured state."""
    return STAND + 0.1 * np.sin(12 * t) * np.tile([0.0, 1.0, -1.0], 4) + 0.2 * (x[7:19] - STAND)


def torque(target: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.asarray(6.0 * (target - x[7:19]) - 0.2 * x[25:37])


class Steady:
    """Plans joint targets; its low level turns the last ones into torques."""

    def __init__(self, tick_steps: int) -> None:
        self.model, self.dt, self.tick_dt = plant(), STEP * PLAN_STEPS, STEP * tick_steps
        self.initial = BODY.state(joints="stand")
        self.plans: list[float] = []
        self.ticks: list[float] = []

    def reset(self, seed: int | None = None) -> None:
        self.target = np.full(12, np.nan)

    def hold(self, x: np.ndarray) -> np.ndarray:
        return 0.5 * torque(STAND + 0.1, x)

    def plan(self, x: Any, t: float) -> PolicyPlan:
        self.plans.append(t)
        self.target = targets(np.asarray(x), t)
        return PolicyPlan(np.full(12, 99.0))  # nobody may apply it: there are ticks

    def tick(self, x: np.ndarray, t: float) -> np.ndarray:
        self.ticks.append(t)
        return torque(self.target, x)

    def judge(self, states: np.ndarray, actions: np.ndarray, t: float) -> Judgement:
        zeros = np.zeros(len(states))
        return Judgement(zeros, zeros + 1, np.zeros((0, len(states))), ())

    def place(self, t: float) -> np.ndarray:
        return np.zeros(2)


def stepped(tick_steps: int, lag: int, steps: int) -> Iterator[tuple[np.ndarray, list[float]]]:
    """Yield the state after each plan's time, and the times of the ticks in it."""
    model = plant().compiled()
    data = mujoco.MjData(model)
    x = BODY.state(joints="stand")
    data.qpos[:], data.qvel[:] = x[:19], x[19:]
    control, target = 0.5 * torque(STAND + 0.1, x), None
    for k in range(steps):
        measured, ticks = np.concatenate([data.qpos, data.qvel]), []
        data.qacc_warmstart[:] = 0.0  # a plan's roll-outs begin so, too
        for i in range(PLAN_STEPS):
            new = i == lag
            if new:
                target = targets(measured, k * STEP * PLAN_STEPS)
            if target is not None and (new or i % tick_steps == 0):
                control = torque(target, np.concatenate([data.qpos, data.qvel]))
                ticks.append((k * PLAN_STEPS + i) * STEP)
            data.ctrl[:] = control
            mujoco.mj_step(model, data)
        yield np.concatenate([data.qpos, data.qvel]), ticks


@pytest.mark.parametrize(("tick_steps", "lag"), [(1, 0), (1, 3), (2, 3), (5, 4), (10, 0)])
def test_ticks_act_between_plans_and_the_plan_before_until_the_latency_has_passed(tick_steps: int, lag: int) -> None:
    controller = Steady(tick_steps)
    assert isinstance(controller, TickingController)
    episode = run_episode(controller, plant(), steps=6, latency=lag * STEP)
    expected = list(stepped(tick_steps, lag, 6))
    np.testing.assert_allclose(episode.states[1:], [x for x, _ in expected], atol=1e-10)
    np.testing.assert_allclose(controller.plans, 0.02 * np.arange(6), atol=1e-12)
    np.testing.assert_allclose(controller.ticks, [t for _, ticks in expected for t in ticks], atol=1e-12)
    assert np.ptp(episode.states[:, 7:19], axis=0).max() > 0.02  # it moved


def test_ticks_at_500_hz_under_plans_at_50_hz_are_counted() -> None:
    controller = Steady(1)
    run_episode(controller, plant(), steps=5, latency=0.006)
    assert len(controller.plans) == 5
    assert controller.ticks[0] == pytest.approx(0.006)  # until then, the control that holds the joints acts
    assert len(controller.ticks) == 5 * 10 - 3
    assert np.diff(controller.ticks) == pytest.approx(0.002)


def test_latency_holds_the_control_before_the_first_plan() -> None:
    controller = Steady(1)
    episode = run_episode(controller, plant(), steps=1, latency=0.02)
    assert controller.ticks == []
    data = mujoco.MjData(plant().compiled())
    data.qpos[:], data.qvel[:] = controller.initial[:19], controller.initial[19:]
    data.ctrl[:] = 0.5 * torque(STAND + 0.1, controller.initial)
    mujoco.mj_step(plant().compiled(), data, PLAN_STEPS)
    np.testing.assert_allclose(episode.states[-1], np.concatenate([data.qpos, data.qvel]), atol=1e-10)


@pytest.mark.parametrize("tick_dt", [0.001, 0.003, 0.006, 0.0])
def test_ticks_that_do_not_fit_the_steps_are_refused(tick_dt: float) -> None:
    controller = Steady(1)
    controller.tick_dt = tick_dt
    with pytest.raises(
        SamplingError, match=r"time between ticks is out of range - got 0.*, expected a multiple of the"
    ):
        run_episode(controller, plant(), steps=1)


# ---- policies as controllers


def test_a_policy_ticks_in_an_episode() -> None:
    trajectory, gains = bow()
    controller = PolicyController(Policy(trajectory, gains), plant())
    assert isinstance(controller, TickingController)
    episode = run_episode(controller, plant(), steps=10)
    model = plant().compiled()
    data = mujoco.MjData(model)
    x = trajectory.phases[0].states[0]
    data.qpos[:], data.qvel[:] = x[:19], x[19:]
    states, plans = [], []
    for step in range(100):
        if step % PLAN_STEPS == 0:
            data.qacc_warmstart[:] = 0.0
        i, k = divmod(step // 10, 5)  # 0.1 s a phase, 0.02 s a stage
        part, share = trajectory.phases[i], (step % 10) / 10
        plan = part.state.np_plus(part.states[k], share * part.state.np_minus(part.states[k + 1], part.states[k]))
        x = np.concatenate([data.qpos, data.qvel])
        states.append(x)
        plans.append(plan)
        data.ctrl[:] = part.controls[k] + gains[i][k] @ part.state.np_minus(x, plan)
        mujoco.mj_step(model, data)
    states.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_allclose(episode.states, states[::10], atol=1e-9)
    off = [BODY.state.np_minus(x, plan) for x, plan in zip(states[:-1:10], plans[::10], strict=True)]
    np.testing.assert_allclose(episode.cost, np.sum(np.square(off), axis=1), atol=1e-9)
    np.testing.assert_allclose(episode.reward, np.exp(-episode.cost))
    assert not episode.fell
    assert episode.missed == {}


def test_the_caller_says_what_a_policys_states_cost_and_what_a_fall_is() -> None:
    trajectory, gains = bow()
    seen = []

    def judge(states: np.ndarray, actions: np.ndarray, t: float) -> Judgement:
        seen.append((states.shape, actions.shape, t))
        return Judgement(np.ones(len(states)), np.ones(len(states)), np.full((1, len(states)), 0.5), ("speed",))

    controller = PolicyController(Policy(trajectory, gains), plant(), tick_dt=0.004, judge=judge)
    strict = run_episode(controller, steps=10, fall=models.Fall(height=inf))
    assert strict.fell
    assert seen == [((1, 37), (1, 12), 0.0)]
    assert strict.missed == {"speed": 0.5}
    assert not run_episode(controller, steps=10, fall=models.Fall(tilt=pi, height=-inf)).fell


def test_models_that_a_policy_cannot_control_are_refused() -> None:
    policy = Policy(*bow())
    with pytest.raises(
        SamplingError, match=r"has other controls - got 'joints.target', expected 'joints.torque'; make"
    ):
        PolicyController(policy, models.Mujoco(ROBOT))
    policy.trajectory.phases[0].states.resize((6, 30), refcheck=False)
    with pytest.raises(
        SamplingError, match="has other states - got 37, expected 30; give the robot that the plan is for"
    ):
        PolicyController(policy, plant())
