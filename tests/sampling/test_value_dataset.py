import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from piaffe import models
from piaffe.errors import FileFormatError, SamplingError
from piaffe.sampling import MPPI, TDCDMPPI, Options, Reward
from piaffe.sampling.learning.collect import Actors, CollectOptions, collect, make_shard
from piaffe.sampling.learning.dataset import Dataset, Records
from piaffe.sampling.learning.options import LearnOptions
from piaffe.sampling.learning.train import train_value
from piaffe.sampling.value import digest
from piaffe.sampling.value.store import load_value

from . import written_out
from .value_problem import trot_problem

DT = 0.1
TOY = CollectOptions(shards=2, explore_steps=6, episodes=5, episode_steps=4, horizon=3, nearest=2)


class Toy:
    """A controller of a point on a line that pushes it to the right; its roll-outs spread with the seed."""

    def __init__(self, samples: int = 6, steps: int = 3) -> None:
        self.shape = (samples, steps + 2, 1)
        self.reset(0)

    def reset(self, seed: int | None = None) -> None:
        self._random = np.random.default_rng(seed)

    def plan(self, x: np.ndarray, t: float) -> Any:
        states = x + np.cumsum(self._random.uniform(-0.1, 0.3, self.shape), axis=1)
        violation = np.maximum(states[None, :, :-1, 0] - np.array([1.0, 1.5])[:, None, None], 0.0)
        return SimpleNamespace(states=states, action=np.array([0.1 + t]), violation=violation)


def score(states: np.ndarray, controls: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
    violation = np.maximum(states[None, :, 0] - np.array([1.0, 1.5])[:, None], 0.0)
    return 0.5 * controls[:, 0] ** 2 + first, violation


def toy(end: float = 2.0) -> Actors:
    return Actors(
        Toy(), Toy(), np.zeros(1), DT, step=lambda x, u: x + u, fallen=lambda states: states[:, 0] > end, score=score
    )


def same(a: Records, b: Records) -> bool:
    return all(np.array_equal(vars(a)[name], vars(b)[name]) for name in vars(a))


def test_shard_holds_episodes_of_the_followed_controller() -> None:
    records = make_shard(toy(end=1e9), TOY, 0)
    assert len(records) == 5 * 4
    np.testing.assert_array_equal(records.episode, np.repeat(np.arange(5), 4))
    np.testing.assert_allclose(records.next_states, records.states + records.actions)
    np.testing.assert_allclose(records.actions[:, 0], 0.1 + records.node * DT)
    for episode in range(5):
        rows = records.episode == episode
        np.testing.assert_array_equal(np.diff(records.node[rows]), 1)
        np.testing.assert_array_equal(records.states[rows][1:], records.next_states[rows][:-1])
        first = records.node[rows][0]
        np.testing.assert_allclose(records.cost[rows], 0.5 * records.actions[rows, 0] ** 2 + first)
    np.testing.assert_allclose(records.violation, np.maximum(records.states - [1.0, 1.5], 0.0))
    assert not records.done.any()


def test_episodes_begin_where_roll_outs_came_to() -> None:
    records = make_shard(toy(end=1e9), TOY, 0)
    starts = records.node[::4]
    assert starts.min() >= TOY.nearest
    assert starts.max() <= TOY.explore_steps - 1 + TOY.horizon + 1
    travelled = np.array([sum(0.1 + k * DT for k in range(max(0, first - 4))) for first in starts])
    assert np.all(records.states[::4, 0] > travelled - 0.5)
    assert len(np.unique(records.states[::4])) == 5


class Counting(Toy):
    """A controller whose roll-outs are in state k at node k; it keeps what it was asked and the violations it told."""

    def __init__(self) -> None:
        self.asked: list[tuple[float, float]] = []
        self.reported: list[np.ndarray] = []
        super().__init__()

    def plan(self, x: np.ndarray, t: float) -> Any:
        self.asked.append((float(x[0]), t))
        nodes = round(t / DT) + np.arange(self.shape[1], dtype=float)
        states = np.broadcast_to(nodes[:, None], self.shape)
        violation = self._random.uniform(size=(2, self.shape[0], self.shape[1] - 1))
        self.reported.append(violation)
        return SimpleNamespace(states=states, action=np.array([0.1]), violation=violation)


def test_episodes_begin_at_the_node_of_the_state_that_they_begin_in() -> None:
    records = make_shard(replace(toy(end=1e9), explore=Counting()), TOY, 0)
    np.testing.assert_array_equal(records.states[::4, 0], records.node[::4])
    assert len(np.unique(records.node[::4])) > 1


def test_exploring_walks_on_in_time_and_state() -> None:
    explore = Counting()
    make_shard(replace(toy(end=1e9), explore=explore), TOY, 0)
    np.testing.assert_allclose(explore.asked, [(0.1 * k, k * DT) for k in range(TOY.explore_steps)], atol=1e-12)


def test_peaks_are_the_largest_violations_among_all_roll_outs_and_steps() -> None:
    follow = Counting()
    records = make_shard(replace(toy(end=1e9), follow=follow), TOY, 0)
    assert len(follow.reported) == len(records)
    for peaks, violation in zip(records.peaks, follow.reported, strict=True):
        assert peaks.tolist() == [max(row.ravel()) for row in violation]


def test_joined_records_are_those_of_both_and_their_episodes_are_counted_on() -> None:
    first, second = make_shard(toy(), TOY, 0), make_shard(toy(), TOY, 1)
    both = first.joined(second)
    assert len(both) == len(first) + len(second)
    for name in ("states", "next_states", "node", "actions", "cost", "violation", "peaks", "done"):
        np.testing.assert_array_equal(getattr(both, name)[: len(first)], getattr(first, name))
        np.testing.assert_array_equal(getattr(both, name)[len(first) :], getattr(second, name))
    np.testing.assert_array_equal(both.episode, [*first.episode, *(5 + second.episode)])
    np.testing.assert_array_equal(np.unique(second.episode), np.arange(5))  # joining changes neither


def test_episode_ends_with_a_fall() -> None:
    records = make_shard(toy(end=1.2), TOY, 0)
    assert records.done.any()
    np.testing.assert_array_equal(records.done, records.next_states[:, 0] > 1.2)
    last = np.append(np.diff(records.episode) != 0, True)
    assert not np.any(records.done & ~last)
    assert np.all(records.states[:, 0] <= 1.2)


def test_shard_follows_from_seed_and_number_alone() -> None:
    actors = toy()
    first = make_shard(actors, TOY, 1)
    make_shard(actors, TOY, 0)
    assert same(make_shard(actors, TOY, 1), first)
    assert not same(make_shard(actors, TOY, 0), first)
    assert not same(make_shard(actors, replace(TOY, seed=1), 1), first)


def test_a_world_of_falls_is_an_error() -> None:
    with pytest.raises(SamplingError, match="every sampled roll-out ended in a fall - got 0 starts after 6 steps"):
        make_shard(toy(end=-10.0), TOY, 0)


def test_dataset_remembers_shards_and_numbers_episodes_anew(tmp_path: Path) -> None:
    dataset = Dataset(tmp_path, {"of": "toy"}, 2)
    assert dataset.missing == (0, 1)
    dataset.write(1, make_shard(toy(), TOY, 1))
    (tmp_path / ".shard-00000.npz.deadbeef.tmp").write_bytes(b"cut off")
    again = Dataset(tmp_path, {"of": "toy"}, 2)
    assert again.missing == (0,)
    with pytest.raises(SamplingError, match="not complete - got 1 shards, expected 2"):
        again.load()
    again.write(0, make_shard(toy(), TOY, 0))
    records = again.load()
    np.testing.assert_array_equal(np.unique(records.episode), np.arange(10))
    first = make_shard(toy(), TOY, 0)
    np.testing.assert_array_equal(records.states[: len(first)], first.states)


def test_data_of_something_else_are_refused(tmp_path: Path) -> None:
    Dataset(tmp_path, {"of": {"reward": 1.0}}, 2)
    with pytest.raises(SamplingError, match=r"got 'of.reward' 2.0, expected 1.0"):
        Dataset(tmp_path, {"of": {"reward": 2.0}}, 2)


@pytest.mark.parametrize("content", [b"", b"nothing", b"PK\x03\x04 half a shard"])
def test_damaged_shard_is_named(tmp_path: Path, content: bytes) -> None:
    dataset = Dataset(tmp_path, {}, 1)
    dataset.file(0).write_bytes(content)
    with pytest.raises(FileFormatError, match=r"shard-00000\.npz': cannot be read"):
        dataset.load()


def test_transitions_are_derived_from_what_happened() -> None:
    records = make_shard(toy(end=1.6), TOY, 0)
    calls = []

    def inputs(states: np.ndarray, k: int) -> np.ndarray:
        calls.append(k)
        return np.column_stack([states[:, 0], np.full(len(states), k)])

    options = Options(p_max={"low": 0.5, "high": 0.1}, violation_floor=0.3)
    transitions = records.transitions(inputs, ("low", "high"), Reward(2.0), options)
    np.testing.assert_array_equal(transitions.inputs, np.column_stack([records.states, records.node]))
    np.testing.assert_array_equal(transitions.next_inputs, np.column_stack([records.next_states, records.node + 1]))
    np.testing.assert_allclose(transitions.rewards, np.exp(-records.cost / 2.0))
    np.testing.assert_array_equal(transitions.done, records.done)
    c_max = records.c_max(0.3)
    np.testing.assert_allclose(c_max, np.maximum(records.peaks.mean(axis=0), 0.3))
    expected = np.max(np.minimum(records.violation / c_max, 1.0) * [0.5, 0.1], axis=1)
    np.testing.assert_allclose(transitions.delta, expected)
    assert transitions.delta.max() > 0
    assert len(calls) == len(set(records.node)) + len(set(records.node + 1))


@pytest.mark.parametrize(("name", "value"), [("episodes", 0), ("horizon", 1), ("seed", -1), ("nearest", 18)])
def test_collecting_options_out_of_range_are_refused(name: str, value: int) -> None:
    with pytest.raises(SamplingError, match=f"{name} is"):
        CollectOptions(**{name: value})


# ---- with a robot


def test_what_happened_is_scored_at_the_nodes_where_it_happened() -> None:
    actors = Actors.of(written_out.problem(), replace(TOY, horizon=4), Reward())
    states = written_out.problem().initial + np.linspace(0.0, 2.0, 6)[:, None] * (np.arange(37) >= 7)
    controls = states[:, 7:19] + 0.3
    for first in (0, 3, 9):
        cost, violation = actors.score(states[:5], controls[:5], first)
        t = first * written_out.DT
        np.testing.assert_allclose(cost, written_out.running_cost(states[None, :5], controls[None, :5], t)[0])
        np.testing.assert_allclose(violation, written_out.violations(states[None, :5], t)[:, 0], atol=1e-12)
    assert violation[9].any()


SMALL = CollectOptions(
    shards=2, explore_steps=2, episodes=2, episode_steps=3, horizon=4, nearest=2,
    explore=replace(MPPI.defaults, samples=8, threads=1), follow=replace(TDCDMPPI.defaults, samples=8, threads=1),
)  # fmt: skip
LEARN = LearnOptions(updates=10, record_every=5, batch=8, hidden=(8,))


@pytest.fixture(scope="module")
def plant() -> models.Mujoco:
    return models.Mujoco(models.load("solo12"), armature=0.01)


def test_collecting_goes_on_where_it_was_cut_off(plant: models.Mujoco, tmp_path: Path) -> None:
    problem = trot_problem(plant=plant)

    def cut(done: int, _total: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(problem, tmp_path / "cut", SMALL, listener=cut)
    seen = []
    resumed = collect(problem, tmp_path / "cut", SMALL, listener=lambda *done: seen.append(done))
    assert seen == [(1, 2), (2, 2)]
    assert same(resumed.load(), collect(problem, tmp_path / "whole", SMALL).load())
    with pytest.raises(SamplingError, match=r"'of.reward.scale' 2.0, expected 1.0"):
        collect(problem, tmp_path / "cut", SMALL, reward=Reward(2.0))
    with pytest.raises(SamplingError, match=r"'options.episode_steps' 4, expected 3"):
        collect(problem, tmp_path / "cut", replace(SMALL, episode_steps=4))
    harder = models.Mujoco(models.load("solo12"), armature=0.01, contact=models.SoftContact(solref=(0.05, 1.0)))
    with pytest.raises(SamplingError, match=r"'simulator.contact.solref'"):
        collect(trot_problem(plant=harder), tmp_path / "cut", SMALL)


def test_first_round_is_followed_alone_and_later_ones_begin_in_roll_outs_with_the_value(
    plant: models.Mujoco, tmp_path: Path
) -> None:
    pytest.importorskip("flax")
    problem, alone = trot_problem(plant=plant), replace(SMALL.follow, p_max=0.9)
    options = replace(SMALL, alone=alone)
    first = Actors.of(problem, options, Reward())
    assert first.explore.options == SMALL.explore
    assert not isinstance(first.explore, TDCDMPPI)
    assert first.follow.options == alone
    file = tmp_path / "trot.value"
    train_value(problem, file, collecting=options, learning=LEARN)
    later = Actors.of(problem, options, Reward(), file)
    for controller in (later.explore, later.follow):
        assert controller.options == SMALL.follow
        assert controller.value is not None


def test_each_round_has_a_seed_of_its_own_and_follows_the_value_of_the_round_before(
    plant: models.Mujoco, tmp_path: Path
) -> None:
    pytest.importorskip("flax")
    options = replace(SMALL, rounds=2, shards=1, seed=7)
    value = train_value(trot_problem(plant=plant), tmp_path / "trot.value", collecting=options, learning=LEARN)
    rounds = [tmp_path / "trot.work" / f"round-{i}" for i in range(2)]
    manifests = [json.loads((place / "data" / "manifest.json").read_text())["options"] for place in rounds]
    assert [each["seed"] for each in manifests] == [7, 8]
    learnt = rounds[0] / "learnt.value"
    assert [each["value"] for each in manifests] == [None, digest(learnt)]
    first, second = (np.load(place / "data" / "shard-00000.npz") for place in rounds)
    assert value.record["transitions"] == len(first["cost"]) + len(second["cost"])
    again = collect(trot_problem(plant=plant), tmp_path / "alone", replace(options, seed=8), value=learnt).load()
    np.testing.assert_array_equal(again.actions, second["actions"])


def test_executor_makes_the_same_shards(plant: models.Mujoco, tmp_path: Path) -> None:
    problem = trot_problem(plant=plant)
    with ThreadPoolExecutor(1) as executor:
        side = collect(lambda: problem, tmp_path / "side", SMALL, executor=executor)
        with pytest.raises(SamplingError, match="cannot be sent to other processes"):
            collect(problem, tmp_path / "other", SMALL, executor=executor)
    assert same(side.load(), collect(problem, tmp_path / "here", SMALL).load())


def test_trained_value_serves_its_controller_and_no_other(plant: models.Mujoco, tmp_path: Path) -> None:
    pytest.importorskip("flax")
    problem = trot_problem(plant=plant)
    file = tmp_path / "trot.value"
    value = train_value(problem, file, collecting=SMALL, learning=LEARN)
    assert value.record["transitions"] == 12
    assert value.record["episodes"] == 4
    np.testing.assert_array_equal(value.record["curves"]["update"], [5, 10])
    controller = TDCDMPPI(problem, replace(SMALL.follow, samples=16), value=file)
    plan = controller.plan(problem.initial, 0.0)
    assert np.all(np.isfinite(plan.returns))
    with pytest.raises(SamplingError, match=r"'discount' 0.8, expected 0.9"):
        TDCDMPPI(problem, discount=0.8, value=file)
    again = train_value(problem, tmp_path / "again", work=file.with_suffix(".work"), collecting=SMALL, learning=LEARN)
    np.testing.assert_array_equal(again.network.head, load_value(file).network.head)


def test_learning_tells_how_far_it_is(plant: models.Mujoco, tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    train_value(
        trot_problem(plant=plant), tmp_path / "told", collecting=SMALL, learning=LEARN,
        progress=lambda stage, done, total: told.append((stage, done, total)),
    )  # fmt: skip
    stages = list(dict.fromkeys(stage for stage, _, _ in told))
    assert stages == ["collecting, shards", "learning, minibatches"]
    last = {stage: (done, total) for stage, done, total in told}
    assert last == {"collecting, shards": (SMALL.shards,) * 2, "learning, minibatches": (LEARN.updates,) * 2}


def test_progress_that_is_no_function_is_refused(plant: models.Mujoco, tmp_path: Path) -> None:
    with pytest.raises(SamplingError, match="progress is no function - got True, expected a function.*stage_bars"):
        train_value(trot_problem(plant=plant), tmp_path / "v", progress=True)


def test_learning_with_another_discount_is_refused(plant: models.Mujoco, tmp_path: Path) -> None:
    with pytest.raises(SamplingError, match=r"got discount 0.95 in learning, expected 0.9"):
        train_value(trot_problem(plant=plant), tmp_path / "v", learning=LearnOptions(discount=0.95))
