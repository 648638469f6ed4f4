"""Collection of transitions: the constraint-discounted controller starts where sampled roll-outs end [TD-CD-MPPI]."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SamplingError
from piaffe.ocp import Nodes, Problem, model_of

from ..controllers import MPPI, TDCDMPPI, Plan
from ..evaluators import scoring
from ..options import Options
from ..reward import Reward
from ..value import ValueInputs, digest, fingerprint, plain
from .dataset import Dataset, Records

Array = NDArray[np.float64]
Listener = Callable[[int, int], None]
"""Called with the number of completed shards and the number of all shards."""


@dataclass(frozen=True, kw_only=True)
class CollectOptions:
    """Options of :func:`collect`. These and the number of a shard determine the content of the shard.

    Args:
        shards: number of shards in each round.
        rounds: rounds of collection and learning. In the first round the controller has no value; in each later round
            it has the value of the round before. A planner goes to states whose value is too high, and the data
            collected there correct the value.
        explore_steps: closed-loop steps of exploration per shard. Episodes begin at states of the roll-outs of these
            steps. Ordinary MPPI explores in the first round; in later rounds the controller with the last value does.
        episodes: episodes per shard.
        episode_steps: steps of each episode; fewer if the robot falls.
        horizon: H of the controller in the episodes, and of MPPI. The robot must walk with this horizon, in the first
            round without a value: if it always falls, the value of all states is low.
        nearest: an episode begins at a random step of a roll-out, from this step to H + 1. In the paper it is always
            H + 1; earlier states make the value accurate for shorter horizons, too.
        explore: options of MPPI, in the first round.
        follow: options of the controller in the episodes; the value is learnt for its γ₀ and its largest discounts.
        alone: options of the controller in the episodes of the first round, without a value; those of ``follow`` by
            default. Without a value, a violation only reduces the rewards up to the horizon, not those after it. So the
            largest discounts that suit a controller with a value are too small for this one.
        seed: seed of all random numbers.
    """

    shards: int = 50
    rounds: int = 1
    explore_steps: int = 100
    episodes: int = 20
    episode_steps: int = 50
    horizon: int = 16
    nearest: int = 4
    explore: Options = field(default_factory=lambda: MPPI.defaults)
    follow: Options = field(default_factory=lambda: TDCDMPPI.defaults)
    alone: Options | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        least = {
            "shards": 1,
            "rounds": 1,
            "explore_steps": 1,
            "episodes": 1,
            "episode_steps": 1,
            "horizon": 2,
            "nearest": 1,
            "seed": 0,
        }
        for name, smallest in least.items():
            if not (isinstance(getattr(self, name), int) and getattr(self, name) >= smallest):
                raise SamplingError(
                    f"collecting options: {name} is out of range - got {getattr(self, name)!r}, expected a whole "
                    f"number, at least {smallest}; change it"
                )
        if self.nearest > self.horizon + 1:
            raise SamplingError(
                f"collecting options: nearest is beyond the horizon - got {self.nearest}, expected at most "
                f"{self.horizon + 1}; reduce it"
            )


class Controller(Protocol):
    """The methods of a controller that the collection uses."""

    def reset(self, seed: int | None = None) -> None:
        """Forget the last plan."""

    def plan(self, x: Array, t: float) -> Plan:
        """Return a plan from a state (nx,) at time t [s]."""
        ...


@dataclass(frozen=True)
class Actors:
    """The two controllers of the collection, and the simulated robot.

    Args:
        explore: controller of the exploration; episodes begin at states of its roll-outs.
        follow: controller of the episodes.
        initial: initial state of the exploration, (nx,).
        dt: time step [s].
        step: function of a state (nx,) and a control (nu,) that returns the next state.
        fallen: function of states (n, nx) that returns which are falls, (n,).
        score: function of states (T, nx), controls (T, nu) and the index of the first node that returns running costs
            (T,) and violations (nc, T).
    """

    explore: Controller
    follow: Controller
    initial: Array
    dt: float
    step: Callable[[Array, Array], Array]
    fallen: Callable[[Array], NDArray[np.bool_]]
    score: Callable[[Array, Array, int], tuple[Array, Array]]

    @classmethod
    def of(cls, problem: Problem, options: CollectOptions, reward: Reward, value: Path | None = None) -> Actors:
        """Return the controllers of a problem; the simulated robot is the planner's own model, as in the paper.

        Without a value, ordinary MPPI explores, as in the paper. With a value, the controller itself explores: it
        evaluates the value at the ends of its own roll-outs, so the value must be accurate there.
        """
        segment = problem.schedule.segments[0]
        schedule = model_of(segment).over(options.horizon * segment.dt, dt=segment.dt).without(*segment.excluded)
        scheduled = problem.with_schedule(schedule)
        acting = options.follow if value is not None else options.alone or options.follow
        follow = TDCDMPPI(scheduled, acting, reward=reward, value=value)
        explore: MPPI = TDCDMPPI(scheduled, acting, reward=reward, value=value)
        if value is None:
            explore = MPPI(scheduled, options.explore, reward=reward)

        def step(x: Array, u: Array) -> Array:
            return np.array(follow.engine.rollout(x, u[None, None]).states[0, 1])

        def score(states: Array, controls: Array, first: int) -> tuple[Array, Array]:
            numbers = follow.nodes.running(first, len(states))
            cost, violation = follow.score(states[None], controls[None], numbers)
            return cost[0].copy(), violation[:, 0].copy()

        return cls(explore, follow, problem.initial, follow.dt, step, follow.model.fallen, score)


def collect(
    problem: Problem | Callable[[], Problem],
    folder: str | Path,
    options: CollectOptions | None = None,
    *,
    reward: Reward | None = None,
    value: Path | None = None,
    executor: Executor | None = None,
    listener: Listener | None = None,
) -> Dataset:
    """Collect a dataset, or the shards of it that are missing.

    Args:
        problem: the problem; with an executor, a function that returns it and that the workers can import.
        folder: folder of the dataset.
        options: see :class:`CollectOptions`.
        reward: reward of the planner.
        value: file of the value that the controller uses; None in the first round.
        executor: an executor of ``concurrent.futures`` that makes shards in parallel; without one, this process makes
            them one after another.
        listener: called after every shard.

    Raises:
        SamplingError: the folder contains data of another problem or of other options.
    """
    options, reward = options or CollectOptions(), reward or Reward()
    here = problem() if callable(problem) else problem
    dataset = Dataset(folder, made_for(here, options, reward, value), options.shards)
    total, missing = options.shards, dataset.missing
    done = total - len(missing)
    if listener is not None:
        listener(done, total)
    if executor is None:
        actors = Actors.of(here, options, reward, value) if missing else None
        for shard in missing:
            assert actors is not None
            dataset.write(shard, make_shard(actors, options, shard))
            done += 1
            if listener is not None:
                listener(done, total)
        return dataset
    if not callable(problem):
        raise SamplingError(
            "collect: a problem cannot be sent to other processes - got a Problem with an executor, expected a "
            "function at the top of a module that returns it; pass that function"
        )
    futures = {executor.submit(_task, problem, options, reward, value, shard): shard for shard in missing}
    try:
        for future in as_completed(futures):
            dataset.write(futures[future], future.result())
            done += 1
            if listener is not None:
                listener(done, total)
    except BaseException:
        for future in futures:
            future.cancel()
        raise
    return dataset


def made_for(problem: Problem, options: CollectOptions, reward: Reward, value: Path | None = None) -> dict[str, Any]:
    """Return the description of a dataset: of the problem, the simulator and the options, without the shard count."""
    nodes = Nodes(problem)
    entries = fingerprint(nodes, reward, options.follow, ValueInputs.standard(nodes))
    settings = {name: value for name, value in plain(options).items() if name not in ("shards", "rounds", "kind")}
    settings["value"] = None if value is None else digest(value)
    made = {"of": entries, "simulator": simulator_of(nodes.model), "options": settings}
    return {**made, "constraints": list(constraints_of(nodes))}


def simulator_of(model: Any) -> dict[str, Any]:
    """Return the settings of a model's simulation. A dataset needs the same for all shards; a value does not."""
    names = ("timestep", "substeps", "contact", "friction", "body_collisions")
    return {name: plain(getattr(model, name)) for name in names if hasattr(model, name)}


def constraints_of(nodes: Nodes) -> tuple[str, ...]:
    """Return the constraint that each row of a violation belongs to, (nc,)."""
    return scoring(nodes.mode).constraints(nodes.terms)


_ACTORS: dict[str, Actors] = {}


def _task(
    make: Callable[[], Problem], options: CollectOptions, reward: Reward, value: Path | None, shard: int
) -> Records:
    """Make a shard in another process, which keeps the controllers for the next shard."""
    key = f"{make!r} {options!r} {reward!r} {value!r}"
    if key not in _ACTORS:
        _ACTORS.clear()
        _ACTORS[key] = Actors.of(make(), options, reward, value)
    return make_shard(_ACTORS[key], options, shard)


# ---- one shard


def make_shard(actors: Actors, options: CollectOptions, shard: int) -> Records:
    """Return the records of one shard."""
    rng = np.random.default_rng([options.seed, shard])
    starts = _start_states(actors, options, rng)
    episodes = [
        _episode(actors, options, start, k, int(rng.integers(2**31))) | {"number": number}
        for number, (start, k) in enumerate(starts)
    ]
    columns = {
        name: np.concatenate([episode[name] for episode in episodes])
        for name in Records.__dataclass_fields__
        if name != "episode"
    }
    numbers = np.repeat([episode["number"] for episode in episodes], [len(episode["cost"]) for episode in episodes])
    return Records(**columns, episode=numbers)


def _start_states(actors: Actors, options: CollectOptions, rng: np.random.Generator) -> list[tuple[Array, int]]:
    """Return states of sampled roll-outs, and the indices of their nodes."""
    per_step = -(-2 * options.episodes // options.explore_steps)
    found: list[tuple[Array, int]] = []
    x, k = actors.initial, 0
    actors.explore.reset(int(rng.integers(2**31)))
    for _ in range(options.explore_steps):
        plan = actors.explore.plan(x, k * actors.dt)
        count, nodes = plan.states.shape[:2]
        nearest = min(options.nearest, nodes - 1)
        for _ in range(per_step):
            n, h = int(rng.integers(count)), int(rng.integers(nearest, nodes))
            end = np.array(plan.states[n, h])
            if not actors.fallen(end[None])[0]:
                found.append((end, k + h))
        x, k = actors.step(x, plan.action), k + 1
        if actors.fallen(x[None])[0]:
            actors.explore.reset(int(rng.integers(2**31)))
            x, k = actors.initial, 0
    if not found:
        raise SamplingError(
            f"collect: every sampled roll-out ended in a fall - got 0 starts after {options.explore_steps} steps, "
            "expected some; look at the problem with piaffe mppi, or narrow the action's range"
        )
    chosen = rng.permutation(len(found))[: options.episodes]
    return [found[i] for i in chosen]


def _episode(actors: Actors, options: CollectOptions, start: Array, first: int, seed: int) -> dict[str, Any]:
    """Return an episode that begins at a state."""
    states: list[Array] = [start]
    actions: list[Array] = []
    peaks: list[Array] = []
    actors.follow.reset(seed)
    fell = False
    while len(actions) < options.episode_steps and not fell:
        plan = actors.follow.plan(states[-1], (first + len(actions)) * actors.dt)
        peaks.append(plan.violation.max(axis=(1, 2), initial=0.0))
        actions.append(np.array(plan.action))
        states.append(actors.step(states[-1], plan.action))
        fell = bool(actors.fallen(states[-1][None])[0])
    cost, violation = actors.score(np.array(states[:-1]), np.array(actions), first)
    count = len(actions)
    done = np.zeros(count, dtype=bool)
    done[-1] = fell
    return {
        "states": np.array(states[:-1]),
        "next_states": np.array(states[1:]),
        "node": first + np.arange(count),
        "actions": np.array(actions),
        "cost": cost,
        "violation": np.ascontiguousarray(violation.T),
        "peaks": np.array(peaks),
        "done": done,
    }
