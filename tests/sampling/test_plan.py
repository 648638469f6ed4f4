"""A plan's numbers against the declaration, computed here from the states and controls that the plan was made from."""

import json

import numpy as np
import pytest

from piaffe import ocp, sampling
from piaffe.sampling import Options, Reward
from piaffe.sampling.value import Layer, Network, Value, ValueInputs, fingerprint

from . import by_hand
from .written_out import ARRIVAL, DT, END, GOAL, STEPS, last_cost, problem, running_cost, target, violations

TIMES = (0.0, 0.06, 0.16)  # of plans: nodes before the arrival, across it, and beyond the motion's end
ENGINES = {"native": 1e-9, "mjx": 1e-4}  # how close: one computes in double, the other in single precision


def made_up(start, controls):
    """Return states (S + 1, nx) that follow from controls (S, nu) as no robot's do; JAX compiles them at once."""
    jnp = pytest.importorskip("jax.numpy")
    h, joint_angles = jnp.arange(1.0, len(controls) + 1)[:, None], start[7:19]
    place = start[:3] + h * jnp.array([0.006, -0.004, 0.003])
    turned = jnp.concatenate([jnp.cos(0.04 * h), jnp.sin(0.04 * h), 0 * h, 0 * h], axis=1)
    bent = joint_angles + 0.2 * jnp.cumsum(controls - joint_angles, axis=0)
    path = jnp.concatenate([place, turned, bent, jnp.zeros((len(controls), 6)), 4.0 * (controls - bent)], axis=1)
    return jnp.concatenate([start[None], path]), jnp.zeros((), dtype=bool)


def plans_of(kind, engine="native", **options):
    """Return a controller with one sample and one stage, and its plans, each with states, controls, cost, violation."""
    if engine == "mjx":
        pytest.importorskip("mujoco.mjx")
    controller = kind(problem(), samples=1, knots=STEPS, first_stages=1, temperature=5.0, engine=engine, **options)
    if engine == "mjx":
        controller.engine.states = made_up
    before, made = None, []
    for t in TIMES:
        start = problem().initial if before is None else before.states[0, 2].copy()
        plan = controller.plan(start, t)
        states, rows = plan.states.copy(), (plan.cost.copy(), plan.violation.copy())
        made.append((plan, states, by_hand.rolled_out(controller, plan, before), *rows))
        before = plan
    return controller, made


def softmax(returns, temperature=5.0):
    weights = np.exp((returns - returns.max()) / (temperature * returns.std()))
    return weights / weights.sum()


# ---- plans


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", [sampling.MPPI, sampling.TDCDMPPI])
def test_cost_and_violation_of_a_plan_are_those_of_its_nodes(kind, engine):
    seen, close = [], ENGINES[engine]
    for t, (plan, states, controls, cost, violation) in zip(TIMES, plans_of(kind, engine)[1], strict=True):
        assert cost == pytest.approx(running_cost(states[:, :-1], controls, t), rel=close)
        assert violation == pytest.approx(violations(states[:, :-1], t), abs=close)
        worst = np.array([violation[:8].max(axis=0), violation[8], violation[9]]) @ np.ones(STEPS + 1) / (STEPS + 1)
        assert list(plan.missed) == ["HAA range", "base height", "knee"]
        assert list(plan.missed.values()) == pytest.approx(worst @ plan.weights)
        seen.append(violation.max(axis=(1, 2)))
    assert np.max(seen, axis=0)[8:].min() > 0  # a row that is never violated would show nothing
    assert np.max(seen, axis=0)[:8].max() > 0


@pytest.mark.parametrize("engine", ENGINES)
def test_return_of_mppi_is_the_mean_reward_the_end_included(engine):
    _, plans = plans_of(sampling.MPPI, engine, reward=sampling.Reward(2.0))
    for t, (plan, states, controls, *_) in zip(TIMES, plans, strict=True):
        rewards = np.exp(-running_cost(states[:, :-1], controls, t) / 2.0)
        last = np.exp(-last_cost(states[:, -1], t) / 2.0)
        assert plan.returns == pytest.approx((rewards.sum(axis=1) + last) / (STEPS + 2), rel=ENGINES[engine])
        assert plan.weights == pytest.approx(softmax(plan.returns), rel=ENGINES[engine])


@pytest.mark.parametrize(("engine", "has_value"), [("native", False), ("native", True), ("mjx", False)])
def test_return_of_td_cd_mppi_is_the_discounted_sum_written_out(engine, has_value):
    asked = []

    def value(states, k, nodes):
        asked.append(k)
        return 3.0 + states[:, 0]

    shares = {"HAA range": 0.3, "base height": 0.1, "knee": 0.6}
    own, close = {"value": value} if has_value else {}, ENGINES[engine]
    controller, plans = plans_of(sampling.TDCDMPPI, engine, p_max=shares, discount=0.8, violation_rate=0.25, **own)
    share, highest = np.repeat([0.3, 0.1, 0.6], [8, 1, 1]), None
    for t, (plan, states, controls, *_) in zip(TIMES, plans, strict=True):
        rewards = np.exp(-running_cost(states[:, :-1], controls, t))
        rows = violations(states[:, :-1], t)
        largest = rows.max(axis=(1, 2))
        highest = largest if highest is None else 0.75 * highest + 0.25 * largest
        for n in range(2):
            weight, total = 1.0, 0.0
            for h in range(STEPS + 1):
                parts = np.clip(rows[:, n, h] / np.maximum(highest, 1e-3), 0.0, 1.0)
                weight *= 0.8 * (1.0 - np.max(share * parts))
                total += weight * rewards[n, h]
            last = 3.0 + states[n, -1, 0] if has_value else np.exp(-last_cost(states[n : n + 1, -1], t)[0])
            assert plan.returns[n] == pytest.approx(total + weight * last, rel=close)
        assert plan.weights == pytest.approx(softmax(plan.returns), rel=close)
    assert asked == ([round(t / DT) + STEPS + 1 for t in TIMES] if has_value else [])
    controller.reset()
    again = controller.plan(problem().initial, 0.0)
    assert again.returns == pytest.approx(plans[0][0].returns, rel=1e-3 * close)  # maxima begin anew, too


def test_an_episodes_costs_and_violations_are_those_of_its_steps():
    controller, _ = plans_of(sampling.TDCDMPPI)
    episode = sampling.run_episode(controller, steps=STEPS + 1, start=0.06)
    states, actions = episode.states[None, :-1], episode.actions[None]
    assert episode.cost == pytest.approx(running_cost(states, actions, 0.06)[0], rel=1e-9)
    assert episode.reward == pytest.approx(np.exp(-episode.cost))
    assert episode.violation == pytest.approx(violations(states, 0.06)[:, 0], abs=1e-12)
    assert episode.violation.max() > 0
    assert episode.times == pytest.approx(0.06 + DT * np.arange(STEPS + 2))
    way = (target(0.16) - target(0.06))[:2]
    assert episode.commanded == pytest.approx(np.linalg.norm(way))
    covered = episode.states[-1, :2] - episode.states[0, :2]
    assert episode.distance == pytest.approx(covered @ way / np.linalg.norm(way))


@pytest.mark.parametrize("engine", ENGINES)
def test_a_learnt_value_is_that_of_the_last_state_at_its_own_node(engine):
    own, seed = ocp.Nodes(problem()), np.random.default_rng(1)
    inputs, options, reward = (
        ValueInputs(["joint positions", "phase", "command"]),
        Options(discount=0.8, p_max=0.0),
        Reward(),
    )
    made_for = json.loads(json.dumps(fingerprint(own, reward, options, inputs)))
    kernel, bias, scale, offset, head = seed.normal(size=(17, 6)) / 2, *seed.normal(size=(4, 6))
    network = Network(np.zeros(17), np.ones(17), (Layer(kernel, bias, scale, offset),), head, 0.3)
    value = Value(network, inputs, made_for)
    _, plans = plans_of(sampling.TDCDMPPI, engine, discount=0.8, p_max=0.0, value=value)
    seen = []
    for t, (plan, states, _, cost, _) in zip(TIMES, plans, strict=True):
        last = min(t + DT * (STEPS + 1), END)
        angle = np.pi * last / END  # the clock of a motion without a cycle makes half a turn
        speed = (GOAL - problem().initial[:3])[:2] / ARRIVAL * (last < ARRIVAL)
        numbers = np.tile([np.cos(angle), np.sin(angle), *speed, 0.0], (2, 1))
        z = np.column_stack([states[:, -1, 7:19], numbers]) @ kernel + bias
        z = np.where(z > 0, z, np.expm1(z))
        z = scale * (z - z.mean(axis=1, keepdims=True)) / np.sqrt(z.var(axis=1, keepdims=True) + 1e-6) + offset
        worth = np.log1p(np.exp(z @ head + 0.3))
        expected = np.exp(-cost) @ 0.8 ** np.arange(1, STEPS + 2) + 0.8 ** (STEPS + 1) * worth
        assert plan.returns == pytest.approx(expected, rel=1e-4)  # networks compute in single precision
        seen.append(worth)
    assert np.ptp(seen) > 0.1


def test_maxima_do_not_see_rollouts_that_failed():
    controller = sampling.TDCDMPPI(problem(), samples=3, first_stages=1, engine="native", discount=0.8, p_max=0.5)
    rollout = controller.engine.rollout

    def broken(*arguments):
        rolled = rollout(*arguments)
        rolled.states[1, 1:, 2], rolled.failed[1] = 50.0, True  # far above the limit on the base's height
        return rolled

    controller.engine.rollout = broken
    plan = controller.plan(problem().initial, 0.06)
    alive = np.array([True, False, True, True])
    assert plan.violation[8, 1].max() > 100 * plan.violation[8, alive].max() > 0
    shares = np.clip(plan.violation / np.maximum(plan.violation[:, alive].max(axis=(1, 2)), 1e-3)[:, None, None], 0, 1)
    weights = np.cumprod(0.8 * (1 - 0.5 * shares.max(axis=0)), axis=1)
    expected = np.sum(weights * np.exp(-plan.cost), axis=1) + weights[:, -1] * np.exp(
        -last_cost(plan.states[:, -1], 0.06)
    )
    assert plan.returns[alive] == pytest.approx(expected[alive], rel=1e-9)


# ---- perturbations


def perturbations(**options):
    """Return what each of three stages of a plan adds to its nodes, (3, n, H + 1, nu), in halves of the range."""
    settings = {"samples": 40, "knots": STEPS, "sigma": 0.05, "first_stages": 3, "engine": "native", "seed": 5}
    controller = sampling.MPPI(problem(), **{**settings, **options})
    rollout, seen = controller.engine.rollout, []

    def watched(start, controls):
        seen.append(controls[:-1] - controls[-1])
        return rollout(start, controls)

    controller.engine.rollout = watched
    controller.plan(problem().initial, 0.0)
    return np.array(seen) / controller.model.action.half_range


def test_perturbations_shrink_from_stage_to_stage_and_towards_the_horizons_start():
    full = perturbations(stage_factor=1.0, node_factor=1.0)
    assert np.all(full[:, :, 0] == 0.0)  # this one is being applied
    assert np.std(full[:, :, 1:], axis=(1, 3)) == pytest.approx(0.05, rel=0.2)
    stages, nodes = np.arange(3)[:, None, None, None], np.arange(STEPS + 1)[:, None]
    by_factors = perturbations(stage_factor=0.5, node_factor=0.8)
    assert by_factors == pytest.approx(full * 0.5**stages * 0.8 ** (STEPS - nodes), abs=1e-12)
    exponent = stages / (0.7 * 3) + (STEPS - nodes) / (0.9 * STEPS)
    published = perturbations(stage_factor=0.7, node_factor=0.9, noise="exponential")
    assert published == pytest.approx(full * np.exp(-exponent), abs=1e-12)
