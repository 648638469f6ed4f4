"""Atomic writing of files, and checked reading of archives of arrays."""

from __future__ import annotations

import io
import json
import os
import secrets
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]
Kind = Literal["damaged", "headless", "foreign", "unversioned", "newer"]

# ---- writing


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the folder of a file; at the end of the block it replaces the file.

    If the block raises, the temporary file is removed and an existing file is unchanged. The folder is created if it is
    missing.

    Args:
        path: the file; the temporary path has the same suffix.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(8)}.tmp{path.suffix}")  # mkstemp ignores the umask
    try:
        yield temporary
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically; its folder is created if it is missing.

    Raises:
        OSError: it cannot be written; an existing file of this name is unchanged.
    """
    with whole_file(path) as temporary, temporary.open("xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays as one compressed ``.npz``, atomically."""
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]  # numpy's stub for keyword arrays
    write_whole(path, content.getvalue())


# ---- reading


@dataclass(frozen=True)
class Fault:
    """The reason why an archive cannot be read.

    Args:
        kind: ``"damaged"``: truncated or not an archive. ``"headless"``: without a readable header. ``"foreign"``: of
            another format. ``"unversioned"``: its version is not a number. ``"newer"``: of a newer version.
        got: what was found instead: an error, or text.
        format: the format in the header.
        version: the version in the header.
    """

    kind: Kind
    got: object
    format: object = None
    version: object = None


Refuse = Callable[[Fault], Exception]
"""Returns the error for a fault; each kind of file has its own."""


def read_arrays(content: bytes) -> Arrays:
    """Return the arrays of an archive by name: the name of the member without ``.npy``.

    Raises:
        Exception: any error of zipfile, zlib and NumPy for damaged bytes; pickled objects are never loaded.
    """
    return _arrays(_members(content))


def read_archive(
    content: bytes, name: str, version: int | None, refuse: Refuse, *, header: str = "header.npy"
) -> tuple[dict[str, Any], Arrays]:
    """Return the header of an archive, and its other arrays by name.

    Args:
        content: the file's bytes.
        name: name of the format; the header must contain it as ``"format"``.
        version: newest readable ``"version"`` of the header; None if the format has no version.
        refuse: returns the error that is raised.
        header: the member with the header as JSON: bytes or text in an array, or plain text.
    """
    try:
        members = _members(content)
        arrays = _arrays({member: data for member, data in members.items() if member != header})
    except Exception as error:  # zipfile, zlib and NumPy raise many kinds of errors for damaged bytes
        raise refuse(Fault("damaged", error)) from error
    try:
        read = _header(members, header)
    except ValueError as error:
        raise refuse(Fault("headless", error)) from error
    found, own = (read.get("format"), read.get("version")) if isinstance(read, dict) else (read, None)
    if found != name or not isinstance(read, dict):
        raise refuse(Fault("foreign", f"format {found!r}", found, own))
    if version is not None and not isinstance(own, int):
        raise refuse(Fault("unversioned", f"version {own!r}", found, own))
    if version is not None and isinstance(own, int) and own > version:
        raise refuse(Fault("newer", f"version {own}", found, own))
    return read, arrays


def _members(content: bytes) -> dict[str, bytes]:
    """Return the members of a zip archive; raise for anything else, and for damage."""
    if content.startswith(b"\x93NUMPY"):
        raise ValueError("a single array")
    if not content.startswith(b"PK"):
        raise ValueError("no archive" if content else "an empty file")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _arrays(members: Mapping[str, bytes]) -> Arrays:
    """Return the arrays among the members of an archive."""
    return {
        name.removesuffix(".npy"): np.load(io.BytesIO(member), allow_pickle=False)
        for name, member in members.items()
        if name.endswith(".npy")
    }


def _header(members: Mapping[str, bytes], name: str) -> Any:
    """Return the header of an archive; raise ValueError if it is missing or cannot be read."""
    if name not in members:
        raise ValueError(f"no '{name}' in the archive")
    if not name.endswith(".npy"):
        return json.loads(members[name])
    stored = np.load(io.BytesIO(members[name]), allow_pickle=False)
    return json.loads(str(stored) if stored.dtype.kind == "U" else bytes(stored))
