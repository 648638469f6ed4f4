"""The user's cache of compiled libraries: indexed by content, written atomically, of limited size.

A library and its manifest are in a folder whose name is the library's key. One rename puts this folder into place::

    <key>/library.so, manifest.json     the time stamp of manifest.json is that of the last use
    building/<key>-<random>/            private to one building process; removed later if that process was killed
    locks/<first two digits of key>     locked by a building process; the system unlocks it when the process ends
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .cpu import Cpu
from .trust import CacheError, distrust, make_private, private_folder

FORMAT = 1
LIMIT = 2**30
"""Default limit of the cache's size [bytes]."""
LIBRARY, MANIFEST = "library.so", "manifest.json"
PATIENCE_S = 600.0
"""Time to wait for another process that builds the same library, before building it here, too [s]."""

_KEY = re.compile(r"[0-9a-f]{64}")
_LOCK = re.compile(r"[0-9a-f]{2}")
_POLL_S = 0.05
_RECENT_S = 60.0  # a library that was used in this time is not removed: a process may be about to load it
_STALE_S = 86400.0  # a private folder of this age without a lock belongs to a killed process


@dataclass(frozen=True)
class Entry:
    """A library in the cache.

    Args:
        folder: its folder.
        manifest: the content of its manifest.
        size: size of the folder [bytes].
        used: time of the last use [s since the epoch].
    """

    folder: Path
    manifest: Mapping[str, Any]
    size: int
    used: float

    @property
    def library(self) -> Path:
        """The file to load."""
        return self.folder / LIBRARY


def default_folder() -> Path:
    """Return ``$PIAFFE_CACHE/native``, or ``piaffe/native`` in the user's cache folder.

    Raises:
        RuntimeError: the user has no home.
    """
    return _default()[0]


def _default() -> tuple[Path, Path]:
    """Return the default folder, and the last of its parents that must be safe from others."""
    own = os.environ.get("PIAFFE_CACHE", "")
    if own:
        root = Path(own).expanduser().absolute()
        return root / "native", root
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if given.is_absolute():  # the standard ignores a relative path
        return given / "piaffe" / "native", given
    home = Path("~").expanduser()
    return home / ".cache" / "piaffe" / "native", home


def usable_folder() -> Path:
    """Return the default folder; a temporary folder of this process, with a warning, if others can change it."""
    try:
        folder, top = _default()
    except RuntimeError:
        return private_folder("there is no home folder; set HOME, or PIAFFE_CACHE to a folder of your own")
    fault = distrust(folder, top)
    if fault:
        return private_folder(
            f"the cache '{folder}' is not safe, {fault}; remove it and run 'chmod go-w' on its folders, or set "
            "PIAFFE_CACHE to a folder that only you can write"
        )
    return folder


class Cache:
    """A folder of compiled libraries, shared by any number of processes.

    Args:
        folder: its folder; by default the user's cache, or a temporary folder if others can change that.
        limit: largest size [bytes]; beyond it, the libraries with the oldest use are removed.
    """

    def __init__(self, folder: Path | None = None, *, limit: int = LIMIT) -> None:
        self.folder = usable_folder() if folder is None else folder
        self.limit = limit

    # ---- reading

    def find(self, key: str, cpu: Cpu) -> Entry | None:
        """Return a library and mark it as used; None if it is missing, damaged or built for another processor."""
        entry = self._read(self.folder / key)
        if entry is None or entry.manifest.get("key") != key or fault_of(entry, cpu):
            return None
        with suppress(OSError):  # a read-only cache can be used, too
            os.utime(entry.folder / MANIFEST)
        return entry

    def entries(self) -> list[Entry]:
        """Return all libraries, the most recently used first."""
        entries = [self._read(path) for path in self._listed(self.folder, _KEY)]
        return sorted((entry for entry in entries if entry is not None), key=lambda entry: -entry.used)

    def size(self) -> int:
        """Return the size of all files in the cache's folder, those of killed processes included [bytes]."""
        return _size(self.folder)

    @staticmethod
    def _listed(folder: Path, pattern: re.Pattern[str]) -> list[Path]:
        try:
            return [path for path in sorted(folder.iterdir()) if pattern.fullmatch(path.name)]
        except (FileNotFoundError, NotADirectoryError):
            return []

    @staticmethod
    def _read(folder: Path) -> Entry | None:
        path = folder / MANIFEST
        try:
            manifest = json.loads(path.read_bytes())
            used = path.stat().st_mtime
        except (OSError, ValueError, RecursionError):
            manifest, used = {}, 0.0
        if not folder.is_dir():
            return None
        return Entry(folder, manifest if _is_plain(manifest) else {}, _size(folder), used)

    # ---- storing

    @contextmanager
    def building(self, key: str, waiting: Callable[[], None] | None = None) -> Iterator[Path]:
        """Lock the key of a library for building, and yield a private folder, which is removed afterwards.

        Args:
            key: of the library.
            waiting: called once if this process has to wait for another one that builds the library.

        Raises:
            CacheError: the folder cannot be written.
        """
        with self._writing():
            make_private(self.folder / "building")
            make_private(self.folder / "locks")
        with self._locked(key[:2], waiting) as locked:
            self._sweep(key[:2] if locked else "")
            with self._writing():
                private = self.folder / "building" / f"{key if locked else 'unlocked'}-{secrets.token_hex(8)}"
                private.mkdir(mode=0o700)
            try:
                yield private
            finally:
                shutil.rmtree(private, ignore_errors=True)

    def store(self, key: str, library: Path, manifest: Mapping[str, Any]) -> Entry:
        """Move a library from a private folder to its place in the cache; then apply the size limit.

        Args:
            key: of the library.
            library: the file; it is moved.
            manifest: information about it; ``cpu`` must be the processor's fingerprint.
        """
        with self._writing():
            ready = library.parent / f"ready-{secrets.token_hex(4)}"
            ready.mkdir(mode=0o700)
            with library.open("rb") as stream:
                os.fsync(stream.fileno())
                digest = hashlib.file_digest(stream, "sha256").hexdigest()
            about = {
                **manifest, "format": FORMAT, "key": key, "size": library.stat().st_size, "sha256": digest,
                "built_at": time.time(),
            }  # fmt: skip
            library.chmod(0o700)  # the linker follows the umask
            library.replace(ready / LIBRARY)
            with (ready / MANIFEST).open("w", encoding="utf-8") as text:
                json.dump(about, text, indent=1)
                text.flush()
                os.fsync(text.fileno())
            (ready / MANIFEST).chmod(0o600)
            target = self.folder / key
            while True:
                try:
                    ready.rename(target)
                    break
                except OSError:
                    if not target.exists():
                        raise
                    self._remove(target)  # it is damaged, or built for another processor
        self.trim(keep=key)
        return Entry(target, about, _size(target), time.time())

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise CacheError(
                f"cache '{self.folder}': cannot be written - got {error.strerror or error}, expected a folder that you "
                "may write, with free space; set PIAFFE_CACHE to another one"
            ) from error

    @contextmanager
    def _locked(self, name: str, waiting: Callable[[], None] | None = None) -> Iterator[bool]:
        """Hold a lock and yield whether it is held; False if files cannot be locked, or its owner takes too long."""
        with self._writing():
            stream = (self.folder / "locks" / name).open("wb")
        with stream:
            locked = _try_lock(stream.fileno())
            if locked is False and waiting is not None:
                waiting()
            deadline = time.monotonic() + PATIENCE_S
            while locked is False and time.monotonic() < deadline:
                time.sleep(_POLL_S)
                locked = _try_lock(stream.fileno())
            try:
                yield bool(locked)
            finally:
                if locked:
                    fcntl.flock(stream.fileno(), fcntl.LOCK_UN)  # closing is not enough: a fork may have a copy

    # ---- removing

    def trim(self, keep: str = "") -> int:
        """Remove the libraries with the oldest use until the size is within the limit; return how many were removed.

        Args:
            keep: key of a library that is not removed.
        """
        entries = self.entries()
        total = sum(entry.size for entry in entries)
        removed = 0
        for entry in reversed(entries):
            if total <= self.limit:
                break
            if entry.folder.name != keep and time.time() - entry.used > _RECENT_S:
                removed += self._remove(entry.folder)
                total -= entry.size
        return removed

    def clear(self) -> tuple[int, int]:
        """Remove every library and the files of killed processes; builds that are running continue.

        Returns:
            The number of removed libraries, and the freed space [bytes].
        """
        before = self.size()
        removed = sum(self._remove(path) for path in self._listed(self.folder, _KEY))
        for lock in self._listed(self.folder / "locks", _LOCK):
            self._sweep_if_free(lock.name)
        self._sweep("")
        return removed, max(0, before - self.size())

    def _sweep_if_free(self, name: str) -> None:
        with suppress(OSError), (self.folder / "locks" / name).open("wb") as stream:
            if _try_lock(stream.fileno()):
                self._sweep(name)
                fcntl.flock(stream.fileno(), fcntl.LOCK_UN)

    def _sweep(self, name: str) -> None:
        """Remove the private folders of a lock that this process holds, and all that are older than a day."""
        for path in self._listed(self.folder / "building", re.compile(r"[\w-]+")):
            with suppress(OSError):
                age = time.time() - path.stat().st_mtime
                if age > _STALE_S or (name and path.name.startswith(name) and _KEY.match(path.name)):
                    shutil.rmtree(path, ignore_errors=True)

    def _remove(self, folder: Path) -> int:
        """Rename a library's folder and delete it; return 1, or 0 if another process has removed it before."""
        away = self.folder / "building" / f"{folder.name}-{secrets.token_hex(8)}"
        try:
            away.parent.mkdir(exist_ok=True, mode=0o700)
            folder.rename(away)
        except FileNotFoundError:
            return 0
        shutil.rmtree(away, ignore_errors=True)
        return 1


def _is_plain(manifest: Any) -> bool:
    """Return whether a manifest has the kinds of entries that are shown."""
    if not isinstance(manifest, dict):
        return False
    texts = [manifest.get(key, "") for key in ("label", "compiler", "cpu_name")]
    numbers = [manifest.get(key, 0.0) for key in ("built_at", "seconds")]
    return all(isinstance(each, str) for each in texts) and all(
        isinstance(each, int | float | None) and not isinstance(each, bool) for each in numbers
    )


def fault_of(entry: Entry, cpu: Cpu) -> str:
    """Return in a few words why a library must not be loaded on this machine; empty if it may be loaded."""
    about = entry.manifest
    if about.get("format") != FORMAT:
        return f"its manifest has format {about.get('format')!r}"
    if about.get("cpu") != cpu.fingerprint:
        return f"it was built for another processor ({about.get('cpu_name', 'unknown')})"
    if fault := distrust(entry.library, entry.folder.parent) or distrust(entry.folder / MANIFEST, entry.folder):
        return fault
    try:
        if entry.library.stat().st_size != about.get("size"):
            return "it is truncated"
        with entry.library.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        return f"it cannot be read ({error.strerror})"
    return "" if digest == about.get("sha256") else "its content has changed"


def _try_lock(descriptor: int) -> bool | None:
    """Try to lock a file; return whether it is locked now, or None if files cannot be locked."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _size(folder: Path) -> int:
    total = 0
    for root, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                total += Path(root, name).lstat().st_size
    return total
