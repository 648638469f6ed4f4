"""Episodes on disk: one ``.npz`` with what happened and what it was made with."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from piaffe.errors import FileFormatError
from piaffe.files import write_whole
from piaffe.simulation import Episode

FORMAT = "piaffe episodes 1"

_ARRAYS = ("times", "states", "actions", "cost", "reward", "violation", "plan_ms", "effective_samples")
_SHORT = frozenset({"states", "actions", "violation", "plan_ms", "effective_samples"})  # seven digits are enough
_REST = tuple(field.name for field in fields(Episode) if field.name not in _ARRAYS)


def save_episodes(path: str | Path, episodes: Mapping[str, Episode], about: Mapping[str, Any] | None = None) -> Path:
    """Write episodes to a file, which appears whole or not at all.

    Args:
        path: the file, ``.npz``.
        episodes: by name, as ``"seed 3"``.
        about: what they were made with, JSON-able.
    """
    path = Path(path)
    rest = {name: {key: getattr(episode, key) for key in _REST} for name, episode in episodes.items()}
    header = {"format": FORMAT, "about": dict(about or {}), "episodes": rest}
    arrays = {
        f"{name}/{key}": np.asarray(getattr(episode, key), dtype=np.float32 if key in _SHORT else np.float64)
        for name, episode in episodes.items()
        for key in _ARRAYS
    }
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, header=np.array(json.dumps(header)), **arrays)
    write_whole(path, content.getvalue())
    return path


def load_episodes(path: str | Path) -> tuple[dict[str, Episode], dict[str, Any]]:
    """Return the episodes of a file by name, and what they were made with.

    Raises:
        FileFormatError: the file is foreign, truncated or of a newer version.
    """
    try:
        with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as content:
            header = json.loads(str(content["header"]))
            if header["format"] != FORMAT:
                raise ValueError(header["format"])
            episodes = {name: _episode(content, name, rest) for name, rest in header["episodes"].items()}
    except (ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise FileFormatError(
            f"file '{path}': holds no episodes that can be read - got {type(error).__name__}: {error}, expected "
            f"'{FORMAT}'; make it anew with `piaffe mppi --save` or `piaffe study`"
        ) from error
    return episodes, header["about"]


def _episode(content: Mapping[str, Any], name: str, rest: Mapping[str, Any]) -> Episode:
    arrays: dict[str, Any] = {key: np.asarray(content[f"{name}/{key}"], dtype=float) for key in _ARRAYS}
    return Episode(**arrays, **{**rest, "constraints": tuple(rest["constraints"])})
