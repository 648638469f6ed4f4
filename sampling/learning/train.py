"""From a problem to a value file: collect, learn, store; each stage goes on where it was left."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, replace
from functools import partial
from multiprocessing import get_context
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from piaffe.errors import SamplingError
from piaffe.ocp import Nodes, Problem

from ..reward import Reward
from ..value import Precision, Value, ValueInputs, fingerprint, load_value, plain
from .collect import CollectOptions, collect, constraints_of, simulator_of
from .dataset import Records
from .options import LearnOptions
from .transitions import Transitions

Progress = Callable[[str, int, int], None]
"""Called with the name of a stage, how much of it is done, and how much there is."""


def train_value(
    problem: Problem | Callable[[], Problem],
    out: str | PathLike[str],
    *,
    collecting: CollectOptions | None = None,
    learning: LearnOptions | None = None,
    reward: Reward | None = None,
    inputs: ValueInputs | None = None,
    work: str | PathLike[str] | None = None,
    executor: Executor | None = None,
    workers: int = 0,
    precision: Precision = "half",
    progress: Progress | None = None,
) -> Value:
    """Learn the value function of the constraint-discounted controller on a problem, and write it to a file.

    Three stages, as published, in as many rounds as asked for: ordinary MPPI, in later rounds the controller itself,
    finds states that sampled roll-outs come to; the controller goes on from each of them; TD(0) learns from what it
    did. A run that is cut off goes on where it was when it is started again.

    Args:
        problem: the declaration; with an executor or workers a function that returns it, importable there.
        out: the file, ``solo12.value``.
        collecting: options of the first two stages.
        learning: options of the third.
        reward: the planner's.
        inputs: what the value sees; :meth:`ValueInputs.standard` by default.
        work: folder of dataset and checkpoints, by default beside the file, ``solo12.work``.
        executor: makes shards side by side.
        workers: processes that do so where no executor is given; none, and this process does.
        precision: of the weights in the file.
        progress: called as the stages go on; ``piaffe.viz.stage_bars`` shows bars.

    Returns:
        The value, as read back from the file.

    Raises:
        SamplingError: ``work`` holds what is of another problem or other options, γ₀ differs between the options, or
            JAX, Flax and Orbax are not installed.
    """
    collecting, learning = collecting or CollectOptions(), learning or LearnOptions()
    reward = reward or Reward()
    if learning.discount != collecting.follow.discount:
        raise SamplingError(
            f"train_value: γ₀ differs between controller and learner - got discount {learning.discount:g} in learning, "
            f"expected {collecting.follow.discount:g} as in collecting.follow; give the same"
        )
    if not (progress is None or callable(progress)):
        raise SamplingError(
            f"train_value: progress is no function - got {progress!r}, expected a function of a stage's name, what is "
            "done and what there is; leave it out, or pass that of `with piaffe.viz.stage_bars() as progress`"
        )
    step = progress or _silent
    learn = _learner()
    target = Path(out)
    folder = Path(work) if work is not None else target.with_suffix(".work")
    nodes = Nodes(problem() if callable(problem) else problem)
    inputs = inputs or ValueInputs.standard(nodes)
    made = fingerprint(nodes, reward, collecting.follow, inputs)
    records: Records | None = None
    value: Value | None = None
    kept: Path | None = None
    with _pool(executor, workers) as pool:
        for number in range(collecting.rounds):
            stage = f"round {number + 1}: " if collecting.rounds > 1 else ""
            place = folder / f"round-{number}"
            dataset = collect(
                problem, place / "data", replace(collecting, seed=collecting.seed + number), reward=reward, value=kept,
                executor=pool, listener=partial(step, f"{stage}collecting, shards"),
            )  # fmt: skip
            records = dataset.load() if records is None else records.joined(dataset.load())
            kept = place / "learnt.value"
            transitions = records.transitions(inputs.bind(nodes), constraints_of(nodes), reward, collecting.follow)
            learned = learn(
                transitions, learning, checkpoints=place / "checkpoints",
                listener=lambda done, total, _, stage=stage: step(f"{stage}learning, minibatches", done, total),
            )  # fmt: skip
            record = _record(collecting, learning, nodes, records, transitions, learned)
            value = Value(learned.network, inputs, made, record, _fall(nodes))
            value.save(kept)
    assert value is not None
    return load_value(value.save(target, precision), features=inputs.features)


def _silent(stage: str, done: int, total: int) -> None:
    """Show nothing."""


def _pool(executor: Executor | None, workers: int) -> AbstractContextManager[Executor | None]:
    """Return who collects: the caller's executor, left open, or processes of our own."""
    if executor is not None or workers == 0:
        return nullcontext(executor)
    # JAX, which learns, has threads of its own: processes are begun anew, not forked
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"))


def _record(
    collecting: CollectOptions, learning: LearnOptions, nodes: Nodes, records: Records, transitions: Transitions,
    learned: Any,
) -> dict[str, Any]:  # fmt: skip
    """Return how a value came about, as JSON-able values."""
    return {
        "command": " ".join(sys.argv),
        "collecting": plain(collecting),
        "learning": plain(asdict(learning)),
        "simulator": simulator_of(nodes.model),
        "transitions": len(records),
        "episodes": int(records.episode.max()) + 1,
        "falls": int(records.done.sum()),
        "mean_reward": plain(transitions.rewards.mean()),
        "mean_delta": plain(transitions.delta.mean()),
        "constraints": list(constraints_of(nodes)),
        "c_max": plain(records.c_max(collecting.follow.violation_floor)),
        "curves": {name: [plain(v) for v in np.asarray(values).tolist()] for name, values in learned.curves.items()},
    }


def _learner() -> Any:
    try:
        from .learn import learn
    except ImportError as error:
        raise SamplingError(
            f"train_value: learning needs packages that are not installed - got {error}, expected JAX, Flax, Optax and "
            "Orbax; run pip install 'piaffe[sampling]'"
        ) from error
    return learn


def _fall(nodes: Nodes) -> dict[str, float]:
    """Return what counts as a fall of the problem's robot; nothing for models that cannot fall."""
    if not hasattr(nodes.model, "fallen"):
        return {}
    from piaffe.models import Fall

    return {name: float(value) for name, value in asdict(Fall()).items()}
