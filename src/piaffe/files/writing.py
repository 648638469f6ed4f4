"""Atomic writing of files, and the check of a destination before work begins."""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from piaffe.errors import FileWriteError

_PROBE = bytes(65536)
_STALE_S = 86400.0  # a temporary file of this age belongs to a process that was killed


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the folder of a file; at the end of the block it replaces the file.

    If the block raises, the temporary file is removed and an existing file is unchanged. The folder is created if it is
    missing. Temporary files that killed processes left for this file are removed.

    Args:
        path: the file; the temporary path has the same suffix.

    Raises:
        FileWriteError: it cannot be written; the operating system's errors do not name it.
    """
    try:
        with _replacing(path) as temporary:
            yield temporary
    except FileWriteError:
        raise
    except OSError as error:
        raise FileWriteError(
            f"file '{path}': cannot be written - got {error.strerror or error}, expected a folder that you may write, "
            "with free space; choose another path"
        ) from error


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_left_over(path)
    temporary = path.with_name(_temporary_name(path))  # mkstemp ignores the umask
    try:
        yield temporary
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):  # the folder may be gone; the first error says more
            temporary.unlink(missing_ok=True)
        raise


def write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically; its folder is created if it is missing.

    Raises:
        FileWriteError: it cannot be written; an existing file of this name is unchanged. The content is in a temporary
            file that the message names, if one can be written.
    """
    try:
        with _replacing(path) as temporary, temporary.open("xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        kept = _rescued(path, content)
        where = (
            f"move '{kept}', which holds the content" if kept else "the content is lost: nothing else can be written"
        )
        raise FileWriteError(
            f"file '{path}': cannot be written - got {error.strerror or error}, expected a folder that you may write, "
            f"with free space; {where}"
        ) from error


def check_destination(path: Path) -> None:
    """Raise an error if a file cannot be written, before the work for it begins; nothing is left behind.

    Raises:
        FileWriteError: it is a folder, its folder cannot be created or written, or the disk is full.
    """
    absent = [folder for folder in path.parents if not os.path.exists(folder)]  # noqa: PTH110  # no error is raised
    try:
        if path.is_dir():
            raise IsADirectoryError(None, "a folder")
        with _replacing(path.with_name(f"{path.name}.probe")) as probe:
            probe.write_bytes(_PROBE)
            descriptor = os.open(probe, os.O_RDONLY)
            try:
                os.fsync(descriptor)  # some file systems tell only now that they are full
            finally:
                os.close(descriptor)
            raise _Written
    except _Written:
        _remove_left_over(path)
    except OSError as error:
        raise FileWriteError(
            f"file '{path}': cannot be written - got {error.strerror or error}, expected a file in a folder that you "
            "may write, with free space; choose another path"
        ) from error
    finally:
        for folder in absent:  # the innermost first
            with suppress(OSError):
                folder.rmdir()


class _Written(Exception):  # no error: it ends the block, which removes the file
    """The probe was written."""


def _rescued(path: Path, content: bytes) -> Path | None:
    """Return a new file of the system's temporary folder with the content; None if it cannot be written."""
    try:
        descriptor, name = tempfile.mkstemp(prefix=f"piaffe-{path.stem}-", suffix=path.suffix)
    except OSError:
        return None
    try:
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(content)
    except OSError:
        with suppress(OSError):
            Path(name).unlink()
        return None
    return Path(name)


# ---- temporary files: .STEM.HOST-PROCESS-RANDOM.tmp.SUFFIX


def _host() -> str:
    return hashlib.sha256(os.uname().nodename.encode()).hexdigest()[:8]


def _temporary_name(path: Path) -> str:
    return f".{path.stem}.{_host()}-{os.getpid()}-{secrets.token_hex(8)}.tmp{path.suffix}"


def _remove_left_over(path: Path) -> None:
    """Remove temporary files for this path whose process has ended, and all that are older than a day."""
    name = re.compile(
        rf"\.{re.escape(path.stem)}\.(?:([0-9a-f]{{8}})-(\d+)-)?[0-9a-f]{{16}}\.tmp{re.escape(path.suffix)}"
    )
    with suppress(OSError):
        for entry in os.scandir(path.parent):
            found = name.fullmatch(entry.name)
            if found is None:
                continue
            with suppress(OSError):
                ended = found[1] == _host() and not _runs(int(found[2]))
                if ended or time.time() - entry.stat(follow_symlinks=False).st_mtime > _STALE_S:
                    Path(entry.path).unlink()


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # it is another user's
        return True
    return True
