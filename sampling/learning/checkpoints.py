"""Checkpoints of a learning run, written by Orbax. An interrupted run continues from its last checkpoint."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import numpy as np
import orbax.checkpoint as ocp

from piaffe.errors import SamplingError
from piaffe.files import read_json, write_whole

from .options import LearnOptions
from .transitions import Transitions


class Checkpoints:
    """A folder of checkpoints of one learning run.

    Args:
        folder: folder of the checkpoints.
        options: options of the run; the checkpoints must be of a run with the same.
        transitions: data of the run; the checkpoints must be of a run with the same.

    Raises:
        SamplingError: the folder contains checkpoints of another run.
    """

    def __init__(self, folder: str | Path, options: LearnOptions, transitions: Transitions) -> None:
        self.folder = Path(folder).absolute()
        self.folder.mkdir(parents=True, exist_ok=True)
        record = json.loads(json.dumps({**asdict(options), "updates": None, "data": _digest(transitions)}))
        note = self.folder / "run.json"
        if note.exists():
            _compare(self.folder, read_json(note, "checkpoints", "choose another folder, or delete this one"), record)
        else:
            write_whole(note, json.dumps(record, indent=1).encode())
        self._manager = ocp.CheckpointManager(
            self.folder / "steps", options=ocp.CheckpointManagerOptions(max_to_keep=2, enable_async_checkpointing=False)
        )

    def restore(self, state: dict[str, Any]) -> tuple[dict[str, Any], list[dict[str, float]]]:
        """Return the last saved state and curves; the given state and no curves if nothing is saved."""
        step = self._manager.latest_step()
        if step is None:
            return state, []
        # The state is a tree of arrays, so Orbax only needs shapes and types.
        shapes = jax.tree.map(ocp.utils.to_shape_dtype_struct, state)
        kept = self._manager.restore(
            step, args=ocp.args.Composite(state=ocp.args.StandardRestore(shapes), curves=ocp.args.JsonRestore())
        )
        return kept["state"], kept["curves"]["points"]

    def save(self, step: int, state: dict[str, Any], curves: list[dict[str, float]]) -> None:
        """Save a state and the curves up to this step."""
        self._manager.save(
            step,
            args=ocp.args.Composite(state=ocp.args.StandardSave(state), curves=ocp.args.JsonSave({"points": curves})),
        )

    def close(self) -> None:
        """Wait until all checkpoints are written."""
        self._manager.close()


def _digest(transitions: Transitions) -> str:
    digest = hashlib.sha256()
    for values in vars(transitions).values():
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def _compare(folder: Path, kept: dict[str, Any], record: dict[str, Any]) -> None:
    for name, value in record.items():
        if kept.get(name) != value:
            raise SamplingError(
                f"checkpoints in {folder}: are of another run - got '{name}' {value!r}, expected "
                f"{kept.get(name)!r}; choose another folder or delete this one"
            )
