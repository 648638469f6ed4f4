from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piaffe.errors import SamplingError, ShapeError
from piaffe.sampling.controllers.discount import discounted_return
from piaffe.sampling.learning.options import LearnOptions
from piaffe.sampling.learning.transitions import Transitions
from piaffe.sampling.value.network import Network

pytest.importorskip("flax")

from piaffe.sampling.learning.learn import explained_variance, learn

SMALL = LearnOptions(
    hidden=(16, 16), batch=32, updates=12_000, record_every=500, learning_rate=1e-3, target_rate=0.05, held_out=0.0
)


def chain(rewards: float | np.ndarray = 0.8, delta: float = 0.0, *, fall: bool = False, steps: int = 20) -> Transitions:
    """Walk along a line in episodes of ``steps``; with ``fall`` each of them ends in one."""
    rng = np.random.default_rng(0)
    states = rng.standard_normal((30, steps + 1, 3))
    total = 30 * steps
    done = np.zeros((30, steps), dtype=bool)
    done[:, -1] = fall
    return Transitions(
        states[:, :-1].reshape(total, 3),
        states[:, 1:].reshape(total, 3),
        np.broadcast_to(rewards, (30, steps)).reshape(total).astype(float),
        np.full(total, delta),
        done.ravel(),
        np.repeat(np.arange(30), steps),
    )


@pytest.fixture(scope="module")
def constant() -> Network:
    return learn(chain(0.8), SMALL).network


def assert_worth(values: np.ndarray, expected: float) -> None:
    """A small network wobbles by a percent between the points it saw; their mean is the fixed point of TD(0)."""
    np.testing.assert_allclose(values, expected, rtol=2e-2)
    assert np.mean(values) == pytest.approx(expected, rel=3e-3)


def test_constant_reward_is_worth_nine_times_itself(constant: Network) -> None:
    assert_worth(constant(chain().inputs), 9 * 0.8)


@pytest.mark.parametrize("steps", [0, 3, 8, 16])
def test_return_of_every_horizon_is_nine_times_a_constant_reward(steps: int, constant: Network) -> None:
    value = np.asarray(constant(chain().inputs[:4]), dtype=float)
    total = discounted_return(np.full((4, steps + 1), 0.8), np.zeros((4, steps + 1)), 0.9, value)
    assert_worth(total, 9 * 0.8)


def test_constant_violation_shortens_the_horizon() -> None:
    learned = learn(chain(0.8, delta=0.25), SMALL)
    gamma = 0.9 * 0.75
    assert_worth(learned.network(chain().inputs), 0.8 * gamma / (1 - gamma))


def test_what_is_learnt_from_is_the_target_network_which_follows_slowly() -> None:
    """With a target that stays where it began, V is γ₀ (r + V₀(x')) of the first network, not the fixed point."""
    transitions, still = chain(0.8), replace(SMALL, target_rate=1e-9)
    first = learn(transitions, replace(still, updates=1, learning_rate=1e-12)).network
    targets = 0.9 * (0.8 + np.asarray(first(transitions.next_inputs), dtype=float))
    values = learn(transitions, replace(still, updates=2000)).network(transitions.inputs)
    assert np.mean(values) == pytest.approx(np.mean(targets), rel=5e-2)
    assert np.mean(targets) < 0.3 * 9 * 0.8


def test_a_fall_is_worth_nothing_afterwards() -> None:
    falls = Transitions(**{**vars(chain(0.8)), "done": np.ones(600, dtype=bool)})
    assert_worth(learn(falls, SMALL).network(falls.inputs), 0.9 * 0.8)


def test_returns_are_those_of_the_planner() -> None:
    rng = np.random.default_rng(1)
    rewards = rng.uniform(size=(30, 20))
    transitions = chain(rewards, delta=0.1)
    returns, weight = transitions.returns(0.9)
    expected = discounted_return(rewards[:1], np.full((1, 20), 0.1), 0.9)
    np.testing.assert_allclose(returns[0], expected[0])
    np.testing.assert_allclose(weight[0], (0.9 * 0.9) ** 20)
    fallen, nothing = chain(rewards, delta=0.1, fall=True).returns(0.9)
    np.testing.assert_allclose(fallen, returns)
    np.testing.assert_array_equal(nothing, 0.0)


def test_explained_variance_of_true_values_is_one_and_of_none_is_zero() -> None:
    rng = np.random.default_rng(2)
    transitions = chain(rng.uniform(size=(30, 20)), fall=True)
    returns, _ = transitions.returns(0.9)
    assert explained_variance(transitions, returns, returns, 0.9) == pytest.approx(1.0)
    assert explained_variance(transitions, np.zeros(600), np.zeros(600), 0.9) == pytest.approx(0.0)


def test_explained_variance_goes_on_from_an_episodes_end_with_the_value_there() -> None:
    rng = np.random.default_rng(7)
    transitions = chain(rng.uniform(size=(30, 30)), delta=0.05, steps=30)
    following, worth = rng.uniform(0.0, 9.0, size=900), np.zeros((30, 31))
    worth[:, -1] = following.reshape(30, 30)[:, -1]  # no episode ends in a fall
    for t in range(29, -1, -1):
        worth[:, t] = 0.9 * 0.95 * (transitions.rewards.reshape(30, 30)[:, t] + worth[:, t + 1])
    values = worth[:, :-1].ravel()
    assert explained_variance(transitions, values, following, 0.9) == pytest.approx(1.0)
    unseen = (0.9 * 0.95) ** np.arange(30, 0, -1) > 0.1  # what comes after the episode weighs more than a tenth
    wrong = values + 5.0 * rng.uniform(size=900) * np.tile(unseen, 30)
    assert explained_variance(transitions, wrong, following, 0.9) == pytest.approx(1.0)


def test_held_out_episodes_are_whole_and_not_learnt_from() -> None:
    train, test = chain().split(0.2, seed=0)
    assert test is not None
    assert len(np.unique(test.episode)) == 6
    assert len(test) == 6 * 20
    assert not set(test.episode) & set(train.episode)


def test_curves_have_a_point_per_interval_and_end_well_on_held_out_episodes() -> None:
    rewards = np.random.default_rng(3).uniform(size=(30, 1))
    fields = vars(chain(rewards, fall=True))
    known = np.column_stack([fields["rewards"], np.tile(np.arange(20) / 20, 30), np.zeros(600)])
    transitions = Transitions(**{**fields, "inputs": known, "next_inputs": known + np.array([0, 1 / 20, 0])})
    options = LearnOptions(**{**vars(SMALL), "held_out": 0.2, "updates": 4200})
    points = []
    learned = learn(transitions, options, listener=lambda done, total, _: points.append((done, total)))
    assert points[0] == (500, 4200)
    assert points[-2:] == [(4000, 4200), (4200, 4200)]
    np.testing.assert_array_equal(learned.curves["update"], [done for done, _ in points])
    assert learned.curves["explained_variance"][-1] > 0.9
    assert learned.curves["held_out_error"][-1] < 0.1 * learned.curves["held_out_error"][0]


def test_weight_decay_keeps_a_network_from_learning_noise_by_heart() -> None:
    noise = chain(np.random.default_rng(1).uniform(0.0, 1.0, (30, 20)))
    options = replace(SMALL, updates=2000)
    free, held = (learn(noise, replace(options, weight_decay=decay)) for decay in (0.0, 30.0))
    assert held.curves["loss"][-1] > 1.2 * free.curves["loss"][-1]
    assert np.std(held.network(noise.inputs)) < 0.8 * np.std(free.network(noise.inputs))


def test_resumed_learning_ends_where_learning_in_one_go_does(tmp_path: Path) -> None:
    transitions = chain(np.random.default_rng(4).uniform(size=(30, 20)))
    options = LearnOptions(**{**vars(SMALL), "updates": 1500})

    def stop(done: int, _total: int, _point: dict[str, float]) -> None:
        if done == 1000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        learn(transitions, options, checkpoints=tmp_path, listener=stop)
    points = []
    resumed = learn(transitions, options, checkpoints=tmp_path, listener=lambda done, *_: points.append(done))
    whole = learn(transitions, options)
    assert points == [1500]
    np.testing.assert_array_equal(resumed.network(transitions.inputs), whole.network(transitions.inputs))
    np.testing.assert_array_equal(resumed.curves["loss"], whole.curves["loss"])


def test_points_of_the_curves_change_nothing_of_what_is_learnt() -> None:
    transitions = chain(np.random.default_rng(4).uniform(size=(30, 20)))
    seldom, often = (learn(transitions, replace(SMALL, updates=120, record_every=every)) for every in (120, 7))
    np.testing.assert_array_equal(often.network(transitions.inputs), seldom.network(transitions.inputs))
    assert len(often.curves["update"]) == 18
    assert often.curves["update"][-1] == 120


def test_nothing_is_learnt_from_held_out_episodes() -> None:
    """All fall at once, so that V is γ₀ r; those that are held out pay ten times as much."""
    fields = {**vars(chain(0.8)), "done": np.ones(600, dtype=bool)}
    options = replace(SMALL, held_out=0.2, updates=2000)
    _, test = Transitions(**fields).split(options.held_out, options.seed)
    assert test is not None
    held = np.isin(fields["episode"], test.episode)
    fields["rewards"] = np.where(held, 8.0, 0.8)
    network = learn(Transitions(**fields), options).network
    inputs = fields["inputs"][~held]
    np.testing.assert_allclose(network.mean, inputs.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(network.std, inputs.std(axis=0), rtol=1e-5)
    assert np.mean(network(inputs)) == pytest.approx(0.9 * 0.8, rel=2e-2)


def test_checkpoints_of_another_run_are_refused(tmp_path: Path) -> None:
    options = LearnOptions(**{**vars(SMALL), "updates": 500})
    learn(chain(), options, checkpoints=tmp_path)
    with pytest.raises(SamplingError, match=r"'discount' 0.95, expected 0.9"):
        learn(chain(), LearnOptions(**{**vars(options), "discount": 0.95}), checkpoints=tmp_path)
    with pytest.raises(SamplingError, match="'data'"):
        learn(chain(0.5), options, checkpoints=tmp_path)


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"rewards": np.full(600, -0.1)}, "rewards from -0.1"),
        ({"rewards": np.full(600, np.nan)}, "'rewards': not finite"),
        ({"delta": np.full(600, 1.5)}, "to 1.5"),
    ],
)
def test_unusable_transitions_are_refused(changed: dict[str, np.ndarray], expected: str) -> None:
    with pytest.raises(SamplingError, match=expected):
        Transitions(**{**vars(chain()), **changed})


def test_rows_that_do_not_match_are_refused() -> None:
    with pytest.raises(ShapeError, match="'done': wrong number of rows - got 3, expected 600"):
        Transitions(**{**vars(chain()), "done": np.zeros(3, dtype=bool)})


@pytest.mark.parametrize(
    ("name", "value"), [("discount", 1.2), ("updates", 0), ("hidden", ()), ("held_out", 1.0), ("weight_decay", -1.0)]
)
def test_options_out_of_range_are_refused(name: str, value: object) -> None:
    with pytest.raises(SamplingError, match=f"{name} is out of range"):
        LearnOptions(**{name: value})
