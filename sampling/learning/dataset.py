"""Datasets of transitions on disk. Each shard is written in one atomic step, so a collection can be interrupted."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import FileFormatError, SamplingError
from piaffe.files import Fault, assembling, read_arrays, read_json, write_arrays, write_whole

from ..controllers import ConstraintDiscount
from ..options import Options
from ..reward import Reward
from ..value import Entries, differences
from .transitions import Transitions

Array = NDArray[np.float64]

FORMAT, VERSION = "piaffe-transitions", 1


@dataclass(frozen=True, eq=False)
class Records:
    """Raw data of episodes. Rewards, discounts and inputs are computed from them, so they can be chosen later.

    Args:
        states: (T, nx).
        next_states: (T, nx).
        node: index of each state's node, (T,); its time is ``node * dt``.
        actions: (T, nu).
        cost: running cost, a rate, (T,).
        violation: violation of every row of constraints, (T, nc).
        peaks: largest violation of every row among the roll-outs of the plan from this state, (T, nc).
        done: whether the next state is a fall, (T,).
        episode: number of the episode, (T,); the rows of an episode are in order of time.
    """

    states: Array
    next_states: Array
    node: NDArray[np.int64]
    actions: Array
    cost: Array
    violation: Array
    peaks: Array
    done: NDArray[np.bool_]
    episode: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.cost)

    def joined(self, more: Records) -> Records:
        """Return these records followed by more records, whose episodes get the next numbers."""
        columns = {name: np.concatenate([ours, vars(more)[name]]) for name, ours in vars(self).items()}
        columns["episode"][len(self) :] += int(self.episode.max()) + 1
        return Records(**columns)

    def c_max(self, floor: float) -> Array:
        """Return the constant c_max of every row, (nc,): the mean peak, near the planner's moving maximum.

        Args:
            floor: least value, as in the planner.
        """
        return np.asarray(np.maximum(self.peaks.mean(axis=0), floor))

    def transitions(
        self, inputs: Callable[[Array, int], Array], constraints: tuple[str, ...], reward: Reward, options: Options
    ) -> Transitions:
        """Return the transitions that a value function is learnt from.

        Args:
            inputs: function of states (n, nx) and the index of their node that returns inputs (n, m).
            constraints: name of the constraint of each row, (nc,).
            reward: the reward as a function of the cost.
            options: options of the controller, with the largest discounts and the floor of c_max.
        """
        discount = ConstraintDiscount.of(constraints, options)
        frozen = {"maxima": self.c_max(options.violation_floor)}
        return Transitions(
            inputs=_by_node(inputs, self.states, self.node),
            next_inputs=_by_node(inputs, self.next_states, self.node + 1),
            rewards=reward(self.cost),
            delta=discount.delta(np.ascontiguousarray(self.violation.T), frozen),
            done=self.done,
            episode=self.episode,
        )


def _by_node(inputs: Callable[[Array, int], Array], states: Array, node: NDArray[np.int64]) -> Array:
    order = np.argsort(node, kind="stable")
    runs = np.split(order, np.flatnonzero(np.diff(node[order])) + 1)
    parts = [np.array(inputs(states[run], int(node[run[0]]))) for run in runs]
    found = np.empty((len(states), parts[0].shape[1]))
    for run, part in zip(runs, parts, strict=True):
        found[run] = part
    return found


class Dataset:
    """A folder of shards and a manifest that describes them.

    Args:
        folder: the folder; it is made if it is missing.
        made_for: description of the data, in values that JSON can hold; it must be that of the folder.
        shards: number of shards when complete; it may be larger than when the folder was made.

    Raises:
        SamplingError: the folder contains data with another description.
    """

    def __init__(self, folder: str | Path, made_for: Mapping[str, Any], shards: int) -> None:
        self.folder, self.shards = Path(folder), shards
        self.folder.mkdir(parents=True, exist_ok=True)
        manifest: Entries = json.loads(json.dumps({"format": FORMAT, "version": VERSION, **made_for}))
        file = self.folder / "manifest.json"
        if not file.exists():
            write_whole(file, json.dumps(manifest, indent=1).encode())
            return
        stored = read_json(file, "dataset", "choose another folder, or delete this one")
        for path, kept, now in differences(stored, manifest)[:1]:
            raise SamplingError(
                f"dataset in {self.folder}: holds data of something else - got '{path}' {json.dumps(now)[:60]}, "
                f"expected {json.dumps(kept)[:60]}; choose another folder or delete this one"
            )

    def file(self, shard: int) -> Path:
        """Return the path of a shard."""
        return self.folder / f"shard-{shard:05d}.npz"

    @property
    def missing(self) -> tuple[int, ...]:
        """Numbers of the shards that are missing."""
        return tuple(i for i in range(self.shards) if not self.file(i).exists())

    def write(self, shard: int, records: Records) -> None:
        """Write a shard."""
        write_arrays(self.file(shard), vars(records))

    def load(self) -> Records:
        """Return the records of all shards, in order; episodes get new numbers.

        Raises:
            SamplingError: shards are missing.
            FileFormatError: a shard cannot be read.
        """
        if self.missing:
            raise SamplingError(
                f"dataset in {self.folder}: is not complete - got {self.shards - len(self.missing)} shards, expected "
                f"{self.shards}; collect the others"
            )
        parts: list[dict[str, NDArray[Any]]] = []
        episodes = 0
        for i in range(self.shards):
            part = self._read(i)
            part["episode"] = part["episode"] + episodes
            episodes = int(part["episode"].max(initial=episodes - 1)) + 1
            parts.append(part)
        return Records(**{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})

    def _read(self, shard: int) -> dict[str, NDArray[Any]]:
        def refuse(fault: Fault) -> FileFormatError:
            got = f"no {fault.got}" if isinstance(fault.got, KeyError) else fault.got
            return FileFormatError(
                f"dataset, '{self.file(shard)}': cannot be read - got {got}, expected a shard; delete it and "
                "collect it again"
            )

        arrays = read_arrays(self.file(shard), refuse)
        with assembling(refuse):
            found = {name: arrays[name] for name in Records.__dataclass_fields__}
            if len({len(values) for values in found.values()}) > 1:
                raise ValueError(f"columns of {[len(values) for values in found.values()]} rows")
            return found
