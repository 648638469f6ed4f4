"""From a problem to a value file: collect, learn, store. An interrupted stage continues from its last file."""

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
from typing import Any, Literal

import numpy as np

from piaffe.errors import SamplingError
from piaffe.ocp import Nodes, Problem

from ..reward import Reward
from ..value import Precision, Value, ValueInputs, fingerprint, load_value, plain
from .collect import CollectOptions, collect, constraints_of, simulator_of
from .dataset import Records
from .options import LearnOptions
from .shown import Progress, shown_line, silent
from .transitions import Transitions


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
    progress: Progress | Literal[False] | None = None,
) -> Value:
    """Learn the value function of the constraint-discounted controller on a problem, and write it to a file.

    Each round has three stages, as published: ordinary MPPI (in later rounds the controller itself) samples roll-outs;
    the controller runs an episode from each of some states of these roll-outs; TD(0) learns from the episodes. To
    continue an interrupted run, start it again.

    Args:
        problem: the problem; with an executor or workers, a function that returns it and that the workers can import.
        out: the file, as ``solo12.value``.
        collecting: options of the first two stages.
        learning: options of the third stage.
        reward: reward of the planner.
        inputs: inputs of the value; :meth:`ValueInputs.standard` by default.
        work: folder of dataset and checkpoints; by default in the folder of the file, as ``solo12.work``.
        executor: makes shards in parallel.
        workers: number of processes that make shards if there is no executor; 0 makes them in this process.
        precision: precision of the weights in the file.
        progress: called after each part of a stage; ``piaffe.viz.stage_bars`` shows bars. By default a line on a
            terminal shows the stage and its parts; False shows nothing.

    Returns:
        The value, as read from the file.

    Raises:
        SamplingError: ``work`` contains data of another problem or of other options, γ₀ differs between the options, or
            JAX, Flax and Orbax are not installed.
    """
    collecting, learning = collecting or CollectOptions(), learning or LearnOptions()
    reward = reward or Reward()
    if learning.discount != collecting.follow.discount:
        raise SamplingError(
            f"train_value: γ₀ differs between the two options - got discount {learning.discount:g} in learning, "
            f"expected {collecting.follow.discount:g} as in collecting.follow; make them equal"
        )
    if not (progress is None or progress is False or callable(progress)):
        raise SamplingError(
            f"train_value: progress is no function - got {progress!r}, expected a function of a stage's name, the "
            "number of completed parts and of all parts; leave it out, pass the one of "
            "`with piaffe.viz.stage_bars() as progress`, or False to show nothing"
        )
    learn = _learner()
    target = Path(out)
    folder = Path(work) if work is not None else target.with_suffix(".work")
    nodes = Nodes(problem() if callable(problem) else problem)
    inputs = inputs or ValueInputs.standard(nodes)
    made = fingerprint(nodes, reward, collecting.follow, inputs)
    records: Records | None = None
    value: Value | None = None
    kept: Path | None = None
    display = shown_line() if progress is None else nullcontext(progress or silent)
    with _pool(executor, workers) as pool, display as step:
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


def _pool(executor: Executor | None, workers: int) -> AbstractContextManager[Executor | None]:
    """Return the executor that collects: the caller's, which stays open, or a new pool of processes."""
    if executor is not None or workers == 0:
        return nullcontext(executor)
    # JAX has threads of its own, so processes must not be forked
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"))


def _record(
    collecting: CollectOptions, learning: LearnOptions, nodes: Nodes, records: Records, transitions: Transitions,
    learned: Any,
) -> dict[str, Any]:  # fmt: skip
    """Return how a value was learnt, in values that JSON can hold."""
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
    """Return the limits beyond which the problem's robot has fallen; empty for models that cannot fall."""
    if not hasattr(nodes.model, "fallen"):
        return {}
    from piaffe.models import Fall

    return {name: float(value) for name, value in asdict(Fall()).items()}
