"""Where compiled libraries may be loaded from: folders that nobody but their owner can change."""

from __future__ import annotations

import atexit
import fcntl
import os
import shutil
import stat
import tempfile
import time
import warnings
from contextlib import suppress
from pathlib import Path

from piaffe.errors import SolverError

from .compilers import NoCompilerError


class CacheError(SolverError):
    """The cache of compiled libraries cannot be written."""


class NoFolderError(NoCompilerError):
    """There is no folder that compiled libraries can be written to and loaded from."""


class CacheWarning(UserWarning):
    """The user's cache is not used; libraries are compiled in a temporary folder of this process."""


def distrust(path: Path, top: Path) -> str:
    """Return in a few words why somebody else may change a file or a folder; empty if nobody can.

    The path and its parents up to the top are examined; those that do not exist yet are not. Where a link leads out of
    the top, all parents of its target are examined, too. A folder may belong to root, a file not. Others can write what
    their group or everybody may write, unless the group is the user's own.

    Args:
        path: the file or folder, below the top or the top itself.
        top: the last parent to examine.
    """
    try:
        real, end = path.resolve(), top.resolve()
    except (OSError, RuntimeError) as error:  # a circle of links
        return f"'{path}' cannot be examined ({error})"
    fault = _distrust(path, top)
    if not fault and (real, end) != (path, top):
        fault = _distrust(real, end if real.is_relative_to(end) else Path(real.anchor))
    return fault


def _distrust(path: Path, top: Path) -> str:
    own = os.geteuid()
    for each in (path, *path.parents):
        try:
            about = each.stat()
        except FileNotFoundError:
            about = None
        except OSError as error:
            return f"'{each}' cannot be examined ({error.strerror})"
        if about is not None:
            is_folder = stat.S_ISDIR(about.st_mode)
            if about.st_uid != own and not (is_folder and about.st_uid == 0):
                return f"'{each}' belongs to another user"
            kept = is_folder and about.st_mode & stat.S_ISVTX  # others cannot rename what is not theirs
            if about.st_mode & stat.S_IWOTH and not kept:
                return f"everybody can write '{each}'"
            if about.st_mode & stat.S_IWGRP and not kept and not _is_private(about.st_gid):
                return f"a group can write '{each}'"
        if each == top:
            break
    return ""


def _is_private(group: int) -> bool:
    """Return whether a group is the user's own, as many systems make one for each user."""
    import grp
    import pwd

    try:
        name = pwd.getpwuid(os.geteuid()).pw_name
        about = grp.getgrgid(group)
    except KeyError:
        return False
    return about.gr_name == name and set(about.gr_mem) <= {name}


def make_private(folder: Path) -> None:
    """Create a folder and its missing parents for this user alone, whatever the umask."""
    if not folder.exists():
        make_private(folder.parent)
        folder.mkdir(mode=0o700, exist_ok=True)  # not parents=True, which creates parents with the umask alone


_PREFIX = "piaffe-cache-"
_HELD = "held"  # a file that is locked as long as a process uses the folder
_CREATED = 60.0  # a folder is locked so many seconds after its creation [s]
_private: list[tuple[int, Path, int]] = []  # process, its temporary folder, and the open file of its lock


def private_folder(why: str) -> Path:
    """Return the temporary folder of this process for libraries, with a warning when it is created.

    Args:
        why: why the user's cache is not used, and what to do.

    Raises:
        NoFolderError: it cannot be created.
    """
    if _private and _private[0][1].is_dir():
        return _private[0][1]
    try:
        _remove_left_over()
        folder = Path(tempfile.mkdtemp(prefix=_PREFIX))
        held = _hold(folder)
    except OSError as error:
        raise NoFolderError(
            f"native backend: no folder for compiled libraries - got {why}, and no temporary folder ({error}), "
            "expected one of them; set PIAFFE_CACHE to a folder that you may write"
        ) from error
    _private[:] = [(os.getpid(), folder, held)]
    atexit.register(_remove)
    warnings.warn(f"compiled libraries are kept only until this process ends: {why}", CacheWarning, stacklevel=2)
    return folder


def is_private(folder: Path) -> bool:
    """Return whether a folder is the temporary folder of this process."""
    return bool(_private) and _private[0][1] == folder


def _hold(folder: Path) -> int:
    """Lock a temporary folder until this process ends, in whatever way, and return the open file."""
    file = os.open(folder / _HELD, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    with suppress(OSError):  # without locks on this file system nobody removes the folder, either
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return file


def _remove_left_over() -> None:
    """Remove the temporary folders of this user whose processes were killed: nobody holds their locks."""
    for folder in Path(tempfile.gettempdir()).glob(_PREFIX + "*"):
        with suppress(OSError):
            about = folder.lstat()
            if about.st_uid != os.geteuid() or time.time() - about.st_mtime < _CREATED:
                continue
            file = os.open(folder / _HELD, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)
            finally:
                os.close(file)


def _remove() -> None:
    """Remove the temporary folder, in the process that created it."""
    if _private and _private[0][0] == os.getpid():
        with suppress(OSError):
            _, folder, held = _private.pop()
            shutil.rmtree(folder)
            os.close(held)
