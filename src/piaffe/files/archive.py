"""Archives of arrays: one writer, and one reader that checks every size before it inflates anything."""

from __future__ import annotations

import io
import json
import math
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import PiaffeError

from .writing import write_whole

Arrays = dict[str, NDArray[Any]]
Kind = Literal["unreadable", "damaged", "headless", "foreign", "unversioned", "newer", "inconsistent"]

SIZES = "arrays"
"""Entry of a header with the type and the shape of every array."""

_CHUNK = 2**20
_SMALL = 2**26  # bytes that an archive without declared sizes may have in any case
_RATIO = 100  # and how many times the size of its file: arrays of numbers are not compressed more than this
_KINDS = "biufU"  # of arrays: no objects, and no records
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}

# ---- writing


def write_archive(
    path: Path, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], *, member: str = "header.npy"
) -> None:
    """Write a header and arrays as one compressed archive, atomically; equal content gives equal files.

    Args:
        path: the file.
        header: values that JSON can hold, with ``"format"``; type and shape of every array are added to it.
        arrays: the arrays by name.
        member: the member with the header, in an array of bytes, or as plain text if it does not end with ``.npy``.

    Raises:
        FileWriteError: it cannot be written, see :func:`~piaffe.files.write_whole`.
    """
    sizes = {name: [array.dtype.str, list(array.shape)] for name, array in arrays.items()}
    text = json.dumps({**header, SIZES: sizes}, indent=None if member.endswith(".npy") else 1).encode()
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        if member.endswith(".npy"):
            _put(archive, member, np.frombuffer(text, dtype=np.uint8))
        else:
            archive.writestr(_entry(member), text)
        for name, array in arrays.items():
            _put(archive, f"{name}.npy", array)
    write_whole(path, content.getvalue())


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays without a header as one compressed ``.npz``, atomically."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            _put(archive, f"{name}.npy", np.asarray(array))
    write_whole(path, content.getvalue())


def _put(archive: zipfile.ZipFile, name: str, array: NDArray[Any]) -> None:
    with archive.open(_entry(name), "w", force_zip64=True) as stream:
        np.lib.format.write_array(stream, array, allow_pickle=False)


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name)  # with the date 1980
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.external_attr = 0o600 << 16
    return entry


# ---- reading


@dataclass(frozen=True)
class Fault:
    """The reason why an archive cannot be read.

    Args:
        kind: ``"unreadable"``: missing, or may not be read. ``"damaged"``: truncated, not an archive, or larger than it
            says. ``"headless"``: without a readable header. ``"foreign"``: of another format. ``"unversioned"``: its
            version is not a number. ``"newer"``: of a newer version. ``"inconsistent"``: its parts do not fit.
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


def read_arrays(source: bytes | Path, refuse: Refuse) -> Arrays:
    """Return the arrays of an archive without a header, by name: the name of the member without ``.npy``.

    Args:
        source: the file, or its bytes.
        refuse: returns the error that is raised.
    """
    with _opened(source, refuse) as (archive, size):
        return _arrays(archive, size, None, "")


def read_archive(
    source: bytes | Path, name: str, version: int | None, refuse: Refuse, *, header: str = "header.npy"
) -> tuple[dict[str, Any], Arrays]:
    """Return the header of an archive, and its other arrays by name.

    The header is read first. The size of every array is compared with the header, or, in files of earlier releases,
    limited to a multiple of the file's size, before any of them is inflated. Pickled objects are never loaded.

    Args:
        source: the file, or its bytes.
        name: name of the format; the header must contain it as ``"format"``.
        version: newest readable ``"version"`` of the header; None if the format has no version.
        refuse: returns the error that is raised.
        header: the member with the header as JSON: bytes or text in an array, or plain text.
    """
    with _opened(source, refuse) as (archive, size):
        try:
            read = _header(archive, header, size)
        except (ValueError, RecursionError) as error:
            raise _Refused(Fault("headless", error)) from error
        found, own = (read.get("format"), read.get("version")) if isinstance(read, dict) else (read, None)
        if found != name or not isinstance(read, dict):
            raise _Refused(Fault("foreign", f"format {found!r}"[:200], found, own))
        if version is not None and (not isinstance(own, int) or isinstance(own, bool)):
            raise _Refused(Fault("unversioned", f"version {own!r}"[:200], found, own))
        if version is not None and isinstance(own, int) and own > version:
            raise _Refused(Fault("newer", f"version {own}", found, own))
        return read, _arrays(archive, size, read.pop(SIZES, None), header)


@contextmanager
def assembling(refuse: Refuse) -> Iterator[None]:
    """Return a context that refuses a file if a step in it fails: the parts of the file do not fit each other.

    Errors of Piaffe pass.

    Args:
        refuse: returns the error that is raised.
    """
    try:
        yield
    except PiaffeError:
        raise
    except Exception as error:  # a header of any content leads to errors of many kinds
        raise refuse(Fault("inconsistent", error)) from error


class _Refused(Exception):  # it never leaves this module
    """A fault that is not damage."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self.fault = fault


class _Bounded(io.BufferedReader):
    """A file of which no more is asked for than it has: a plain one takes the memory for what a damaged size says."""

    def __init__(self, raw: io.FileIO) -> None:
        super().__init__(raw)
        self._end = os.fstat(raw.fileno()).st_size

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(self._end - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))


@contextmanager
def _opened(source: bytes | Path, refuse: Refuse) -> Iterator[tuple[zipfile.ZipFile, int]]:
    """Yield an archive and the size of its file [bytes]; refuse it for any error within the block."""
    try:
        stream: IO[bytes] = io.BytesIO(source) if isinstance(source, bytes) else _Bounded(io.FileIO(source))
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        raise refuse(Fault("unreadable", getattr(error, "strerror", None) or error)) from error
    with stream:
        try:
            begin = stream.read(6)
            if begin.startswith(b"\x93NUMPY"):
                raise ValueError("a single array")
            if not begin.startswith(b"PK"):
                raise ValueError("no archive" if begin else "an empty file")
            size = stream.seek(0, os.SEEK_END)
            with zipfile.ZipFile(stream) as archive:
                names = archive.namelist()
                if len(set(names)) < len(names):
                    raise ValueError("two members of one name")
                yield archive, size
        except _Refused as refused:
            raise refuse(refused.fault) from refused.__cause__
        except Exception as error:  # zipfile, zlib and NumPy raise many kinds of errors for damaged bytes
            raise refuse(Fault("damaged", error)) from error


def _header(archive: zipfile.ZipFile, name: str, size: int) -> Any:
    """Return the header of an archive; raise ValueError or RecursionError if it is missing or cannot be read."""
    if name not in archive.namelist():
        raise ValueError(f"no '{name}' in the archive")
    about = archive.getinfo(name)
    _check_size(about.file_size, size, "a header")
    if not name.endswith(".npy"):
        with _member(archive, about) as stream:
            return json.loads(stream.read())
    stored = _array(archive, about)
    return json.loads(str(stored) if stored.dtype.kind == "U" else stored.tobytes())


def _arrays(archive: zipfile.ZipFile, size: int, declared: Any, header: str) -> Arrays:
    """Return the arrays of an archive by name.

    Args:
        archive: the archive.
        size: of its file [bytes].
        declared: type and shape of each by name, from the header; None in files of earlier releases.
        header: the member that is none of them.
    """
    members = {
        about.filename.removesuffix(".npy"): about
        for about in archive.infolist()
        if about.filename.endswith(".npy") and about.filename != header
    }
    if declared is None:
        _check_size(sum(about.file_size for about in members.values()), size, "arrays")
        return {name: _array(archive, about) for name, about in members.items()}
    if not isinstance(declared, dict):
        raise ValueError(f"a header with arrays {declared!r}"[:200])
    for name in [*declared, *members]:
        if name not in members:
            raise _Refused(Fault("inconsistent", KeyError(name)))
        if name not in declared:
            raise _Refused(Fault("inconsistent", f"array '{name}', which the header does not name"))
    return {name: _array(archive, about, declared[name]) for name, about in members.items()}


def _check_size(inflated: int, size: int, what: str) -> None:
    """Raise ValueError if a part without a declared size is too large for its file."""
    if inflated > max(_SMALL, _RATIO * size):
        raise ValueError(f"{what} of {inflated} bytes in a file of {size} bytes")


def _member(archive: zipfile.ZipFile, about: zipfile.ZipInfo) -> IO[bytes]:
    """Open a member; raise ValueError if it is compressed in a way whose memory is not limited."""
    if about.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"'{about.filename}' is compressed by method {about.compress_type}")
    return archive.open(about)


def _array(archive: zipfile.ZipFile, about: zipfile.ZipInfo, declared: Any = None) -> NDArray[Any]:
    """Return an array of an archive; raise ValueError, before memory is taken for it, if its sizes contradict."""
    name = about.filename
    with _member(archive, about) as stream:
        version = np.lib.format.read_magic(stream)
        if version not in _HEADERS:
            raise ValueError(f"'{name}' is an array of version {version}")
        shape, by_columns, dtype = _HEADERS[version](stream)
        if dtype.kind not in _KINDS or dtype.itemsize == 0 or any(length < 0 for length in shape):
            raise ValueError(f"'{name}' is an array {shape} of {dtype}")
        if declared is not None and declared != [dtype.str, list(shape)]:
            raise ValueError(f"'{name}' is an array {shape} of {dtype}, but the header says {declared}"[:300])
        count = math.prod(shape)
        if stream.tell() + count * dtype.itemsize != about.file_size:
            raise ValueError(f"'{name}' has {about.file_size} bytes, but is an array {shape} of {dtype}")
        content = np.empty(count * dtype.itemsize, dtype=np.uint8)
        done = 0
        while done < content.size and (part := stream.read(_CHUNK)):
            content[done : done + len(part)] = np.frombuffer(part, dtype=np.uint8)
            done += len(part)
        if done < content.size or stream.read(1):  # at the end, zipfile compares the check sum
            raise ValueError(f"'{name}' ends after {done} of {content.size} bytes")
    values: NDArray[Any] = content.view(dtype)
    return values.reshape(shape[::-1]).T if by_columns else values.reshape(shape)
