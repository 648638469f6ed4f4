"""Files that appear whole or not at all, and archives of arrays that are checked when they are read."""

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
    """Yield a path beside a file, to write to; at the end of the block it takes the file's place.

    If the block raises, what it wrote is removed and an older file is untouched. The folder is made if it is missing.

    Args:
        path: the file; the path that is yielded has its ending.
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
    """Write a file that appears whole or not at all; its folder is made if it is missing.

    Raises:
        OSError: it cannot be written; an older file of this name is untouched.
    """
    with whole_file(path) as temporary, temporary.open("xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays as one compressed ``.npz``, which appears whole or not at all."""
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]  # numpy's stub for keyword arrays
    write_whole(path, content.getvalue())


# ---- reading


@dataclass(frozen=True)
class Fault:
    """Why an archive cannot be read.

    Args:
        kind: ``"damaged"``: truncated or no archive. ``"headless"``: no header that can be read. ``"foreign"``: of
            another format. ``"unversioned"``: its version is no number. ``"newer"``: of a newer version.
        got: what was found instead: an error, or text.
        format: what the header says of its format.
        version: what it says of its version.
    """

    kind: Kind
    got: object
    format: object = None
    version: object = None


Refuse = Callable[[Fault], Exception]
"""Makes the error of a fault, in the words of the kind of file."""


def read_arrays(content: bytes) -> Arrays:
    """Return the arrays of an archive by name, which is that of its member without ``.npy``.

    Raises:
        Exception: whatever zipfile, zlib and NumPy raise for damaged bytes; pickled objects are never loaded.
    """
    return _arrays(_members(content))


def read_archive(
    content: bytes, name: str, version: int | None, refuse: Refuse, *, header: str = "header.npy"
) -> tuple[dict[str, Any], Arrays]:
    """Return the header of an archive, and its arrays by name, the header's left out.

    Args:
        content: the file's bytes.
        name: of its format, which the header must hold as ``"format"``.
        version: the newest that can be read, of the header's ``"version"``; None if the format has none.
        refuse: makes the error that is raised.
        header: the member that holds it as JSON: bytes or text in an array, or plain text.
    """
    try:
        members = _members(content)
        arrays = _arrays({member: data for member, data in members.items() if member != header})
    except Exception as error:  # damaged bytes raise whatever zipfile, zlib and NumPy raise for them
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
    """Return the header of an archive; raise ValueError if there is none that can be read."""
    if name not in members:
        raise ValueError(f"no '{name}' in the archive")
    if not name.endswith(".npy"):
        return json.loads(members[name])
    stored = np.load(io.BytesIO(members[name]), allow_pickle=False)
    return json.loads(str(stored) if stored.dtype.kind == "U" else bytes(stored))
