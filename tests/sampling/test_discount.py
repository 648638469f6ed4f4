import numpy as np
import pytest

from piaffe.errors import PiaffeError, SamplingError
from piaffe.sampling.controllers.discount import ConstraintDiscount, discounted_return
from piaffe.sampling.controllers.mppi import softmax
from piaffe.sampling.controllers.noise import deviations
from piaffe.sampling.options import Options
from piaffe.sampling.reward import Reward


@pytest.mark.parametrize("horizon", [1, 4, 8, 16, 20])
def test_a_constant_reward_returns_nine_times_it_at_every_horizon(horizon):
    r = np.full((3, horizon + 1), 0.7)
    value = np.full(3, 9 * 0.7)  # the fixed point of V = γ0 (r + V) at γ0 = 0.9
    assert discounted_return(r, 0 * r, 0.9, value) == pytest.approx(9 * 0.7, rel=1e-12)


def test_return_is_the_sum_written_out():
    rng = np.random.default_rng(0)
    r, delta, value = rng.random((4, 6)), 0.5 * rng.random((4, 6)), rng.random(4)
    for n in range(4):
        weight, total = 1.0, 0.0
        for h in range(6):
            weight *= 0.9 * (1 - delta[n, h])
            total += weight * r[n, h]
        assert discounted_return(r, delta, 0.9)[n] == pytest.approx(total, rel=1e-12)
        assert discounted_return(r, delta, 0.9, value)[n] == pytest.approx(total + weight * value[n], rel=1e-12)


def test_a_violation_never_pays():
    r = np.random.default_rng(1).random((50, 9))
    delta = np.zeros_like(r)
    free = discounted_return(r, delta, 0.9)
    delta[:, 4] = 0.1
    assert np.all(discounted_return(r, delta, 0.9) < free)


def test_the_worst_constraint_counts():
    discount = ConstraintDiscount.of(("a", "a", "b"), Options(p_max={"a": 0.2, "b": 0.5}, violation_floor=1e-9))
    memory = discount.follow(discount.initial_memory(), np.array([2.0, 1.0, 4.0]))
    violation = np.array([[1.0, 0.0, 9.0], [0.0, 0.0, 9.0], [0.0, 2.0, 0.0]])[:, None, :]
    assert discount.delta(violation, memory)[0] == pytest.approx([0.2 * 0.5, 0.5 * 0.5, 0.2])


def test_a_constraint_without_share_is_left_out():
    discount = ConstraintDiscount.of(("a", "b"), Options(p_max={"a": 0.0}))
    memory = discount.follow(discount.initial_memory(), np.array([1.0, 1.0]))
    assert discount.delta(np.array([[[1.0]], [[0.0]]]), memory) == pytest.approx(0.0)


def test_maxima_follow_the_batch_and_never_fall_below_the_floor():
    discount = ConstraintDiscount.of(("a",), Options(violation_rate=0.25, violation_floor=0.1))
    first = discount.follow(discount.initial_memory(), np.array([8.0]))
    assert discount.maxima(first) == pytest.approx(8.0)
    memory = discount.follow(first, np.array([0.0]))
    assert discount.maxima(memory) == pytest.approx(6.0)
    assert discount.maxima(first) == pytest.approx(8.0)  # what was remembered stays as it was
    for _ in range(60):
        memory = discount.follow(memory, np.array([0.0]))
    assert discount.maxima(memory) == pytest.approx(0.1)
    assert discount.maxima(discount.follow(discount.initial_memory(), np.array([0.2]))) == pytest.approx(0.2)


def test_a_share_for_a_constraint_that_is_not_there_is_refused():
    with pytest.raises(PiaffeError, match="no constraint 'hight'"):
        ConstraintDiscount.of(("height",), Options(p_max={"hight": 0.1}))


def test_weights_of_equal_returns_are_equal():
    assert softmax(np.full(5, 3.0), 0.05) == pytest.approx(0.2)


def test_weights_do_not_depend_on_offset_and_scale():
    returns = np.random.default_rng(2).random(20)
    assert softmax(5 * returns + 3, 0.2) == pytest.approx(softmax(returns, 0.2), rel=1e-9)


def test_published_factors():
    options = Options(node_factor=0.9, stage_factor=0.5)
    assert deviations(options, 0, 2) == pytest.approx([0.6561, 0.729, 0.81, 0.9, 1.0])
    assert deviations(options, 1, 2) == pytest.approx(np.array([0.6561, 0.729, 0.81, 0.9, 1.0]) / 2)


def test_published_exponents():
    options = Options(node_factor=0.9, stage_factor=0.5, noise="exponential")
    assert deviations(options, 0, 2) == pytest.approx([0.329, 0.435, 0.574, 0.757, 1], abs=5e-4)
    assert deviations(options, 1, 2)[-1] == pytest.approx(0.368, abs=5e-4)


def test_rewards_lie_between_zero_and_one():
    cost = np.array([0.0, 2.0, 1e9])
    assert Reward(scale=2.0)(cost) == pytest.approx([1.0, np.exp(-1), 0.0])


@pytest.mark.parametrize("scale", [0.0, -1.0, np.inf, "a"])
def test_a_reward_without_scale_is_refused(scale):
    with pytest.raises(SamplingError, match="scale is out of range"):
        Reward(scale)


@pytest.mark.parametrize(
    "wrong",
    [
        {"samples": 0}, {"knots": 1}, {"temperature": 0.0}, {"discount": 1.5}, {"noise": "pink"}, {"p_max": 2.0},
        {"engine": "gazebo"}, {"threads": 0}, {"shift": "back"}, {"p_max": {"a": -1.0}}, {"temperature": "hot"},
        {"temperature": float("inf")}, {"sigma": np.ones(3)}, {"sigma": True}, {"samples": True}, {"threads": 1.5},
        {"threads": "2"}, {"discount": "0.9"}, {"p_max": "big"}, {"p_max": [0.1]}, {"p_max": {"a": "b"}},
    ],
)  # fmt: skip
def test_options_out_of_range_are_refused(wrong):
    name = next(iter(wrong))
    with pytest.raises(SamplingError, match=rf"sampling options \(test_discount.py:\d+\): {name} is out of range"):
        Options(**wrong)
