"""Datasets of transitions on disk: shards that appear whole or not at all, so that collecting can be cut off."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import FileFormatError, SamplingError
from piaffe.files import read_arrays, write_arrays, write_whole

from ..controllers import ConstraintDiscount
from ..options import Options
from ..reward import Reward
from ..value import Entries, differences
from .transitions import Transitions

Array = NDArray[np.float64]

FORMAT, VERSION = "piaffe-transitions", 1


@dataclass(frozen=True, eq=False)
class Records:
    """What happened, raw: rewards, discounts and inputs are derived from it, so they may be chosen later.

    Args:
        states: (T, nx).
        next_states: (T, nx).
        node: index of each state's node, (T,); its time is ``node * dt``.
        actions: (T, nu).
        cost: running cost, a rate, (T,).
        violation: of every row of constraints, (T, nc).
        peaks: largest violation of every row among the roll-outs of the plan made there, (T, nc).
        done: whether the next state is a fall, (T,).
        episode: which episode each is of, (T,); the rows of one follow each other in time.
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
        """Return these records and more of the same, their episodes counted on."""
        columns = {name: np.concatenate([ours, vars(more)[name]]) for name, ours in vars(self).items()}
        columns["episode"][len(self) :] += int(self.episode.max()) + 1
        return Records(**columns)

    def c_max(self, floor: float) -> Array:
        """Return the frozen c_max of every row, (nc,): the mean peak, which the planner's moving maximum hovers about.

        Args:
            floor: least value, as in the planner.
        """
        return np.asarray(np.maximum(self.peaks.mean(axis=0), floor))

    def transitions(
        self, inputs: Callable[[Array, int], Array], constraints: tuple[str, ...], reward: Reward, options: Options
    ) -> Transitions:
        """Return the transitions that a value function is learnt from.

        Args:
            inputs: of states (n, nx) at a node, (n, m).
            constraints: the constraint that each row belongs to, (nc,).
            reward: how cost becomes reward.
            options: the controller's, for the largest discounts and the floor of c_max.
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
    """A folder of shards and the manifest that says what they are of.

    Args:
        folder: where it is; made if missing.
        made_for: what the data are of, JSON-able; a folder of other data is refused.
        shards: how many there are to be; a folder may be opened with more than it was made with.

    Raises:
        SamplingError: the folder holds data of something else.
    """

    def __init__(self, folder: str | Path, made_for: Mapping[str, Any], shards: int) -> None:
        self.folder, self.shards = Path(folder), shards
        self.folder.mkdir(parents=True, exist_ok=True)
        manifest: Entries = json.loads(json.dumps({"format": FORMAT, "version": VERSION, **made_for}))
        file = self.folder / "manifest.json"
        if not file.exists():
            write_whole(file, json.dumps(manifest, indent=1).encode())
            return
        for path, kept, now in differences(json.loads(file.read_text()), manifest)[:1]:
            raise SamplingError(
                f"dataset in {self.folder}: holds data of something else - got '{path}' {json.dumps(now)[:60]}, "
                f"expected {json.dumps(kept)[:60]}; choose another folder or delete this one"
            )

    def file(self, shard: int) -> Path:
        """Return where a shard is."""
        return self.folder / f"shard-{shard:05d}.npz"

    @property
    def missing(self) -> tuple[int, ...]:
        """The shards that are still to be made."""
        return tuple(i for i in range(self.shards) if not self.file(i).exists())

    def write(self, shard: int, records: Records) -> None:
        """Write a shard."""
        write_arrays(self.file(shard), vars(records))

    def load(self) -> Records:
        """Return the records of all shards, in their order; episodes are numbered anew.

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
        try:
            arrays = read_arrays(self.file(shard).read_bytes())
            return {name: arrays[name] for name in Records.__dataclass_fields__}
        except Exception as error:  # damaged bytes raise whatever zipfile, zlib and NumPy raise for them
            raise FileFormatError(
                f"dataset, '{self.file(shard)}': cannot be read - got {error}, expected a shard; delete it and collect "
                "it again"
            ) from error
