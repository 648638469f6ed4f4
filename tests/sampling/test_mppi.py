import mujoco
import numpy as np
import pytest

from piaffe import models, ocp, sampling
from piaffe.errors import ModelError, PiaffeError, ProblemError, SamplingError, ShapeError
from piaffe.models import base, feet, joints
from piaffe.sampling.controllers.td_cd import TDCDMPPI

from . import by_hand

DT = 0.02


@pytest.fixture(scope="module")
def trot():
    robot = models.load("solo12")
    simulated = models.Mujoco(robot)
    objective = ocp.Objective(
        ocp.track(base.linear_velocity, weight=(2, 2, 0)),
        ocp.track(base.orientation, weight=1.0),
        ocp.track(feet.height, weight=80.0),
    )
    limits = ocp.Constraints(models.joint_range("HAA", 0.05, scale=0.05), models.base_height(maximum=0.23, scale=0.23))
    motion = models.gaits.trot(speed=0.3)
    return ocp.Problem(
        motion, simulated.over(4 * DT, dt=DT), objective, limits, initial=simulated.state(joints="stand")
    )


def controller_of(problem, kind=sampling.DIAL, **options):
    return kind(problem, **{"samples": 24, "first_stages": 2, **options})


@pytest.mark.parametrize("kind", [sampling.MPPI, sampling.DIAL, sampling.TDCDMPPI])
def test_a_plan_is_one_of_its_kind(trot, kind):
    controller = controller_of(trot, kind)
    plan = controller.plan(trot.initial, 0.0)
    action = controller.model.action
    assert plan.controls.shape == (5, 12)
    assert plan.states.shape == (25, 6, 37)
    assert np.all((plan.controls >= action.lower - 1e-12) & (plan.controls <= action.upper + 1e-12))
    assert plan.action == pytest.approx(plan.controls[0])
    assert plan.weights.sum() == pytest.approx(1.0)
    assert 1.0 <= plan.effective_samples <= 25.0
    assert set(plan.missed) == {"HAA range", "base height"}
    assert set(plan.seconds) == {"sample", "roll_out", "evaluate", "value", "weigh"}


def test_the_plan_is_the_mean_of_the_samples_by_weight(trot):
    controller = controller_of(trot, first_stages=1)
    seen = []
    update = controller.update
    controller.update = lambda xp, samples, *rest: seen.append(samples.copy()) or update(xp, samples, *rest)
    plan = controller.plan(trot.initial, 0.0)
    mean = np.einsum("n,njc->jc", plan.weights, seen[-1])
    assert plan.controls == pytest.approx(controller._controls(mean[None])[0], abs=1e-12)
    assert plan.returns == pytest.approx(np.exp(-plan.cost).mean(axis=1), rel=1e-12)


@pytest.mark.parametrize(("engine", "close"), [("native", 1e-12), ("simd", 1e-7)])
def test_rollouts_are_what_the_simulator_does(trot, engine, close):
    options = {"samples": 1, "first_stages": 1, "temperature": 5.0, "engine": engine}
    controller, before = controller_of(trot, sampling.MPPI, **options), None
    for k, start in enumerate((trot.initial, trot.initial + 0.1 * (np.arange(37) >= 19))):
        plan = controller.plan(start, k * DT)
        controls = by_hand.rolled_out(controller, plan, before)
        states = np.array([by_hand.stepped(controller.model, start, each) for each in controls])
        assert np.abs(np.diff(states, axis=1)).max(axis=2).min() > 0.01  # no two states in a row look alike
        assert plan.states == pytest.approx(states, abs=close)
        before = plan
    assert np.abs(np.diff(controls, axis=0)).max(axis=2).min(axis=0)[1:].min() > 0.1  # nor do the two roll-outs


def test_equal_seeds_give_equal_plans(trot):
    controller = controller_of(trot)
    first = [controller.plan(trot.initial, k * DT).controls for k in range(3)]
    controller.reset()
    again = [controller.plan(trot.initial, k * DT).controls for k in range(3)]
    controller.reset(seed=1)
    other = controller.plan(trot.initial, 0.0).controls
    assert np.array_equal(first, again)
    assert not np.array_equal(first[0], other)


def test_the_control_that_is_being_applied_is_not_perturbed(trot):
    controller = controller_of(trot)
    before = controller.plan(trot.initial, 0.0)
    after = controller.plan(trot.initial, DT)
    shifted = controller._controls((controller.spline.to_nodes @ _normal(controller, before.controls, 1))[None])
    assert after.action == pytest.approx(shifted[0, 0], abs=1e-9)


def _normal(controller, controls, count):
    normal = (controls - controller._centre) / controller._half
    return np.vstack([normal[count:], np.zeros((count, controls.shape[1]))])


def test_a_shift_of_no_whole_step_is_refused_or_made_by_the_spline(trot):
    controller = controller_of(trot)
    controller.plan(trot.initial, 0.0)
    with pytest.raises(SamplingError, match="not a whole number of steps after the last one"):
        controller.plan(trot.initial, 0.013)
    deployed = controller_of(trot, shift="elapsed", sigma=1e-9, first_stages=1)
    first = deployed.plan(trot.initial, 0.0)
    second = deployed.plan(trot.initial, 0.5 * DT)
    assert second.action == pytest.approx(0.5 * (first.controls[0] + first.controls[1]), abs=0.02)
    late = deployed.plan(trot.initial, 1.0)
    assert late.action == pytest.approx(deployed._centre)


def test_failed_rollouts_get_the_worst_return_and_are_counted(trot):
    controller = controller_of(trot)
    rollout = controller.engine.rollout

    def broken(*arguments):
        rolled = rollout(*arguments)
        rolled.failed[[3, 5]] = True
        return rolled

    controller.engine.rollout = broken
    plan = controller.plan(trot.initial, 0.0)
    assert plan.failed == 2
    assert plan.returns[[3, 5]] == pytest.approx(plan.returns.min())
    assert np.all(np.isfinite(plan.controls))


def test_when_every_rollout_fails_the_plan_stays(trot):
    controller = controller_of(trot)
    first = controller.plan(trot.initial, 0.0)
    rollout = controller.engine.rollout

    def broken(*arguments):
        rolled = rollout(*arguments)
        rolled.failed[:] = True
        return rolled

    controller.engine.rollout = broken
    plan = controller.plan(trot.initial, DT)
    assert plan.failed == 25
    assert plan.action == pytest.approx(first.controls[1], abs=1e-6)
    assert np.all(np.isfinite(plan.controls))


def test_terms_at_the_end_count_once_more(trot):
    end = ocp.track(base.linear_velocity, weight=1e3, at="end")
    with_end = ocp.Problem(trot.motion, trot.schedule, trot.objective + end, trot.constraints, initial=trot.initial)
    controller = controller_of(with_end)
    plan = controller.plan(with_end.initial, 0.0)
    running = np.exp(-plan.cost)
    speeds = plan.states[:, -1, controller.model.state.slices[base.linear_velocity]]
    last = np.exp(-0.5e3 * np.sum((speeds - controller.nodes.sample(5)[base.linear_velocity]) ** 2, axis=1))
    assert plan.returns == pytest.approx((running.sum(axis=1) + last) / 6, rel=1e-9)
    assert last.max() < 1.0


def test_terms_at_the_ends_of_phases_are_refused(trot):
    end = ocp.track(base.position, at="phase_end")
    other = ocp.Problem(trot.motion, trot.schedule, trot.objective + end, trot.constraints, initial=trot.initial)
    with pytest.raises(ProblemError, match="applies nowhere along a sampled motion"):
        sampling.DIAL(other)


def test_a_model_with_derivatives_is_not_sampled(trot):
    body = models.WholeBody(models.load("solo12"))
    other = ocp.Problem(trot.motion, body.over(0.08, dt=DT), trot.objective, initial=trot.initial)
    with pytest.raises(ProblemError, match="its schedule cannot be sampled"):
        sampling.MPPI(other)


def test_a_model_that_is_no_simulator_is_not_sampled(trot):
    small = models.SingleRigidBody(models.load("solo12"))
    objective = ocp.Objective(ocp.track(base.linear_velocity), ocp.regularize(feet.force, weight=1e-3))
    other = ocp.Problem(trot.motion, small.over(0.08, dt=DT), objective, initial=small.state())
    with pytest.raises(SamplingError, match="its model cannot be rolled out - got SingleRigidBody"):
        sampling.MPPI(other)


@pytest.mark.parametrize(
    ("state", "error", "says"),
    [
        (np.zeros(5), ShapeError, "got shape (5,), expected (37,)"),
        (np.full(37, np.nan), SamplingError, "state is not finite"),
    ],
)
def test_states_that_are_none_are_refused(trot, state, error, says):
    with pytest.raises(error) as raised:
        controller_of(trot).plan(state, 0.0)
    assert says in str(raised.value)


def test_constraint_discounting_avoids_what_it_discounts(trot):
    free = controller_of(trot, sampling.DIAL, samples=200)
    bound = controller_of(trot, sampling.TDCDMPPI, samples=200, p_max=0.9)
    missed = [
        sum(c.plan(trot.initial, k * DT).missed["HAA range"] for k in range(4)) for c in (free, bound)
    ]  # fmt: skip
    assert missed[1] < 0.7 * missed[0]


def test_the_value_of_the_last_state_counts(trot):
    def forward(states, k, nodes):
        assert k == 5
        return 50.0 * np.maximum(states[:, 0], 0.0)

    controller = controller_of(trot, TDCDMPPI, value=forward, p_max=0.0, first_stages=1)
    plan = controller.plan(trot.initial, 0.0)
    weights = 0.9 ** np.arange(1, 6)
    expected = np.exp(-plan.cost) @ weights + weights[-1] * forward(plan.states[:, -1], 5, None)
    assert plan.returns == pytest.approx(expected, rel=1e-9)


def test_an_episode_reports_what_happened(trot):
    controller = controller_of(trot, samples=64)
    episode = sampling.run_episode(controller, steps=12, seed=3)
    assert episode.states.shape == (13, 37)
    assert not episode.fell
    assert episode.summary()["steps"] == 12
    assert set(episode.missed) == {"HAA range", "base height"}
    heights = controller.model.height_above_terrain(episode.states[:-1])
    assert episode.missed["base height"] == pytest.approx(np.maximum(heights - 0.23, 0).mean() / 0.23, rel=1e-9)
    again = sampling.run_episode(controller, steps=12, seed=3)
    assert np.array_equal(episode.states, again.states)


def test_a_robot_on_its_side_has_fallen(trot):
    controller = controller_of(trot)
    lying = controller.model.state(rpy=(1.2, 0, 0), position=(0, 0, 0.2))
    episode = sampling.run_episode(controller, steps=5, initial=lying)
    assert episode.fell
    assert not episode.success


def test_latency_holds_the_control_before(trot):
    steps, lag = 4, 5  # of the controller; of the plant's simulator, 0.002 s each
    episode = sampling.run_episode(controller_of(trot), steps=steps, latency=0.01, seed=3)
    model = controller_of(trot).model.as_plant().compiled()
    data, state = mujoco.MjData(model), trot.initial
    data.qpos[:], data.qvel[:] = state[: model.nq], state[model.nq :]
    data.ctrl[:] = state[7:19]  # before the first plan the joints are held where they are
    for action, after in zip(episode.actions, episode.states[1:], strict=True):
        data.qacc_warmstart[:] = 0.0  # as in a roll-out, contacts of a control step begin from nothing
        for i in range(10):
            if i == lag:
                data.ctrl[:] = action
            mujoco.mj_step(model, data)
        assert np.array_equal(after, np.r_[data.qpos, data.qvel])
    with pytest.raises(SamplingError, match="latency is out of range"):
        sampling.run_episode(controller_of(trot), steps=3, latency=0.03)


@pytest.mark.parametrize("latency", [0.0, 0.01])
def test_an_episodes_actions_are_plans_of_the_state_at_the_steps_start(trot, latency):
    episode = sampling.run_episode(controller_of(trot), steps=3, latency=latency, start=0.1, seed=3)
    alone = controller_of(trot)
    alone.reset(3)
    for k, action in enumerate(episode.actions):
        assert np.array_equal(alone.plan(episode.states[k], 0.1 + k * DT).action, action)


# ---- what is refused


def test_a_share_for_no_constraint_is_refused_when_the_controller_is_made(trot):
    with pytest.raises(PiaffeError, match="p_max: no constraint 'hight'"):
        sampling.TDCDMPPI(trot, samples=4, p_max={"hight": 0.1})


def of_terms(trot, *costs, constraints=()):
    segment = trot.schedule.segments[0]
    return ocp.Problem(
        trot.motion, segment.model.over(4 * DT, dt=DT), ocp.Objective(*costs), ocp.Constraints(*constraints),
        initial=trot.initial,
    )  # fmt: skip


def test_terms_that_apply_nowhere_are_refused(trot):
    speed = ocp.track(base.linear_velocity, weight=1.0)
    with pytest.raises(ProblemError, match=r"'hip range' \(.*\): applies nowhere - .* no component 'hip' \(it has"):
        controller_of(of_terms(trot, speed, constraints=[models.joint_range("hip", 0.1)]))
    cone = models.friction_cone()
    with pytest.raises(ProblemError, match="'friction cone' .* cannot supply 'feet.contact_force'"):
        controller_of(of_terms(trot, speed, constraints=[cone]))
    with pytest.raises(ModelError, match="no component 'hip'"):
        controller_of(of_terms(trot, ocp.track(joints.position, weight={"hip": 1.0})))
    whole = of_terms(trot, speed, constraints=[cone])
    segment = whole.schedule.segments[0]
    controller_of(whole.with_schedule(segment.model.over(4 * DT, dt=DT).without(cone)))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [({"reward": 0.3}, "reward is unusable - got 0.3"), ({"value": 3}, "value is unusable - got int")],
)
def test_what_is_no_reward_or_value_is_refused(trot, wrong, message):
    with pytest.raises(SamplingError, match=f"controller: {message}"):
        sampling.TDCDMPPI(trot, samples=8, **wrong)


@pytest.mark.parametrize("t", [-1.0, np.nan, np.inf])
def test_times_before_the_start_or_without_end_are_refused(trot, t):
    with pytest.raises(SamplingError, match="plan: time is out of range"):
        controller_of(trot).plan(trot.initial, t)


def test_an_episode_needs_steps_and_a_plant_of_the_same_robot(trot):
    controller = controller_of(trot)
    with pytest.raises(SamplingError, match="steps are out of range - got 0"):
        sampling.run_episode(controller, steps=0)
    for plant in (models.WholeBody(models.load("solo12")), models.Mujoco(models.load("go2"))):
        with pytest.raises(SamplingError, match="plant is unusable - got .*, expected .* of robot 'solo12'"):
            sampling.run_episode(controller, plant)
