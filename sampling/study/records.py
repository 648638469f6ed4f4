"""Episodes on disk: one ``.npz`` file with their data and the settings that they were made with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from piaffe.errors import FileFormatError
from piaffe.files import Fault, assembling, read_archive, write_archive
from piaffe.simulation import Episode

FORMAT = "piaffe episodes 1"

_ARRAYS = ("times", "states", "actions", "cost", "reward", "violation", "plan_ms", "effective_samples")
_SHORT = frozenset({"states", "actions", "violation", "plan_ms", "effective_samples"})  # seven digits are enough
_REST = tuple(field.name for field in fields(Episode) if field.name not in _ARRAYS)


def save_episodes(path: str | Path, episodes: Mapping[str, Episode], about: Mapping[str, Any] | None = None) -> Path:
    """Write episodes to a file, in one atomic step.

    Args:
        path: the file, ``.npz``.
        episodes: episodes by name, as ``"seed 3"``.
        about: settings that they were made with, in values that JSON can hold.
    """
    path = Path(path)
    rest = {name: {key: getattr(episode, key) for key in _REST} for name, episode in episodes.items()}
    header = {"format": FORMAT, "about": dict(about or {}), "episodes": rest}
    arrays = {
        f"{name}/{key}": np.asarray(getattr(episode, key), dtype=np.float32 if key in _SHORT else np.float64)
        for name, episode in episodes.items()
        for key in _ARRAYS
    }
    write_archive(path, header, arrays)
    return path


def load_episodes(path: str | Path) -> tuple[dict[str, Episode], dict[str, Any]]:
    """Return the episodes of a file by name, and the settings that they were made with.

    Raises:
        FileFormatError: the file is of another kind, truncated or of a newer version.
    """

    def refuse(fault: Fault) -> FileFormatError:
        return _refusal(path, fault.got)

    header, arrays = read_archive(Path(path), FORMAT, None, refuse)
    with assembling(refuse):
        about = header["about"]
        if not isinstance(about, dict):
            raise ValueError(f"settings {about!r}"[:200])
        return {name: _episode(arrays, name, rest) for name, rest in header["episodes"].items()}, about


def _refusal(path: str | Path, got: object) -> FileFormatError:
    """Return the error for a file without episodes, or with damaged ones."""
    found = f"{type(got).__name__}: {got}" if isinstance(got, Exception) else got
    return FileFormatError(
        f"file '{path}': holds no episodes that can be read - got {found}, expected '{FORMAT}'; make it again with "
        "`piaffe mppi --save` or `piaffe study`"
    )


def _episode(content: Mapping[str, Any], name: str, rest: Mapping[str, Any]) -> Episode:
    arrays: dict[str, Any] = {key: np.asarray(content[f"{name}/{key}"], dtype=float) for key in _ARRAYS}
    episode = Episode(**arrays, **{**rest, "constraints": tuple(rest["constraints"])})
    steps, rows = len(episode.actions), len(episode.constraints)
    expected: dict[str, tuple[int, ...]] = dict.fromkeys(("cost", "reward", "plan_ms", "effective_samples"), (steps,))
    expected |= {"times": (steps + 1,), "violation": (rows, steps)}
    for key, shape in expected.items():
        if arrays[key].shape != shape:
            raise ValueError(f"'{name}/{key}' {arrays[key].shape}, beside {steps} actions and {rows} constraints")
    if episode.states.ndim != 2 or episode.actions.ndim != 2 or len(episode.states) != steps + 1:
        raise ValueError(f"'{name}/states' {episode.states.shape}, beside actions {episode.actions.shape}")
    numbers = (episode.steps, episode.distance, episode.commanded, episode.failed_rollouts)
    if not (all(isinstance(each, int | float) for each in numbers) and isinstance(episode.fell, bool)):
        raise ValueError(f"figures {numbers}, fell {episode.fell}"[:200])
    if not all(isinstance(each, str) for each in episode.constraints):
        raise ValueError(f"constraints {episode.constraints}"[:200])
    return episode
