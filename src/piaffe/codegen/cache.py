"""The user's cache of compiled libraries: found by content, never half written, bounded in size.

A library lies with its manifest in a folder named by its key, and that folder appears by one rename::

    <key>/library.so, manifest.json     manifest.json's time is that of the last use
    building/<key>-<random>/            private to one builder; swept when nobody holds the lock
    locks/<first two digits of key>     held by a builder; the system lets go of it when the builder dies
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

from piaffe.errors import SolverError

from .cpu import Cpu

FORMAT = 1
LIMIT = 2**30
"""Size that the cache is kept below by default [bytes]."""
LIBRARY, MANIFEST = "library.so", "manifest.json"
PATIENCE_S = 600.0
"""How long to wait for another builder of the same library before building it as well."""

_KEY = re.compile(r"[0-9a-f]{64}")
_LOCK = re.compile(r"[0-9a-f]{2}")
_POLL_S = 0.05
_RECENT_S = 60.0  # what was used so recently may be about to be loaded
_STALE_S = 86400.0  # a private folder of that age without a lock is left over


@dataclass(frozen=True)
class Entry:
    """A library in the cache.

    Args:
        folder: where it lies.
        manifest: what was written with it.
        size: of the folder [bytes].
        used: when it was last used [s since the epoch].
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
    """Return ``$PIAFFE_CACHE/native``, or ``piaffe/native`` in the user's cache folder."""
    own = os.environ.get("PIAFFE_CACHE", "")
    if own:
        return Path(own).expanduser().absolute() / "native"
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    root = given if given.is_absolute() else Path("~/.cache").expanduser()  # a relative one is to be ignored
    return root / "piaffe" / "native"


class Cache:
    """A folder of compiled libraries, shared by any number of processes.

    Args:
        folder: where; the user's cache by default.
        limit: size to keep below [bytes]; what was not used for longest goes first.
    """

    def __init__(self, folder: Path | None = None, *, limit: int = LIMIT) -> None:
        self.folder = default_folder() if folder is None else folder
        self.limit = limit

    # ---- finding

    def find(self, key: str, cpu: Cpu) -> Entry | None:
        """Return a library and mark it as used, or None if it is absent, damaged or made for another processor."""
        entry = self._read(self.folder / key)
        if entry is None or entry.manifest.get("key") != key or fault_of(entry, cpu):
            return None
        with suppress(OSError):  # a cache that is only read is of use, too
            os.utime(entry.folder / MANIFEST)
        return entry

    def entries(self) -> list[Entry]:
        """Return all libraries, the last used first."""
        found = [self._read(path) for path in self._listed(self.folder, _KEY)]
        return sorted((entry for entry in found if entry is not None), key=lambda entry: -entry.used)

    def size(self) -> int:
        """Return the size of all that lies in the cache, leftovers included [bytes]."""
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
        except (OSError, ValueError):
            manifest, used = {}, 0.0
        if not folder.is_dir():
            return None
        return Entry(folder, manifest if isinstance(manifest, dict) else {}, _size(folder), used)

    # ---- storing

    @contextmanager
    def building(self, key: str, waiting: Callable[[], None] | None = None) -> Iterator[Path]:
        """Hold the right to build a library; yields a private folder that is gone afterwards.

        Args:
            key: of the library.
            waiting: called once if another builder has to be waited for.

        Raises:
            SolverError: the folder cannot be written.
        """
        with self._writing():
            (self.folder / "building").mkdir(parents=True, exist_ok=True, mode=0o700)
            (self.folder / "locks").mkdir(exist_ok=True, mode=0o700)
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
        """Put a library that lies in a private folder where all find it; then make room.

        Args:
            key: of the library.
            library: the file; it is moved.
            manifest: what is worth knowing about it; ``cpu`` has to be the processor's fingerprint.
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
            library.replace(ready / LIBRARY)
            with (ready / MANIFEST).open("w", encoding="utf-8") as text:
                json.dump(about, text, indent=1)
                text.flush()
                os.fsync(text.fileno())
            target = self.folder / key
            while True:
                try:
                    ready.rename(target)
                    break
                except OSError:
                    if not target.exists():
                        raise
                    self._remove(target)  # damaged, or of another processor: nobody builds what is there and good
        self.trim(keep=key)
        return Entry(target, about, _size(target), time.time())

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise SolverError(
                f"cache '{self.folder}': cannot be written - got {error.strerror or error}, expected a folder of "
                "your own with room in it; set PIAFFE_CACHE to another one"
            ) from error

    @contextmanager
    def _locked(self, name: str, waiting: Callable[[], None] | None = None) -> Iterator[bool]:
        """Hold a lock; yields whether it is held: not where there are no locks, or if its owner takes too long."""
        with self._writing():
            stream = (self.folder / "locks" / name).open("wb")
        with stream:
            locked = _take(stream.fileno())
            if locked is False and waiting is not None:
                waiting()
            deadline = time.monotonic() + PATIENCE_S
            while locked is False and time.monotonic() < deadline:
                time.sleep(_POLL_S)
                locked = _take(stream.fileno())
            try:
                yield bool(locked)
            finally:
                if locked:
                    fcntl.flock(stream.fileno(), fcntl.LOCK_UN)  # closing does not: a fork may hold a copy

    # ---- removing

    def trim(self, keep: str = "") -> int:
        """Remove what was not used for longest until the rest is within the limit; return how many were removed.

        Args:
            keep: key of a library that stays.
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
        """Remove every library and what killed builders left; builds under way go on.

        Returns:
            How many libraries were removed, and what has become free [bytes].
        """
        before = self.size()
        removed = sum(self._remove(path) for path in self._listed(self.folder, _KEY))
        for lock in self._listed(self.folder / "locks", _LOCK):
            self._sweep_if_free(lock.name)
        self._sweep("")
        return removed, max(0, before - self.size())

    def _sweep_if_free(self, name: str) -> None:
        with suppress(OSError), (self.folder / "locks" / name).open("wb") as stream:
            if _take(stream.fileno()):
                self._sweep(name)
                fcntl.flock(stream.fileno(), fcntl.LOCK_UN)

    def _sweep(self, name: str) -> None:
        """Remove the private folders that belong to a lock held here, and any that is older than a day."""
        for path in self._listed(self.folder / "building", re.compile(r"[\w-]+")):
            with suppress(OSError):
                age = time.time() - path.stat().st_mtime
                if age > _STALE_S or (name and path.name.startswith(name) and _KEY.match(path.name)):
                    shutil.rmtree(path, ignore_errors=True)

    def _remove(self, folder: Path) -> int:
        """Take a library away at once, then delete it; return 1, or 0 if another process was faster."""
        away = self.folder / "building" / f"{folder.name}-{secrets.token_hex(8)}"
        try:
            away.parent.mkdir(exist_ok=True, mode=0o700)
            folder.rename(away)
        except FileNotFoundError:
            return 0
        shutil.rmtree(away, ignore_errors=True)
        return 1


def fault_of(entry: Entry, cpu: Cpu) -> str:
    """Return why a library must not be loaded here, in a few words, or nothing if it may."""
    about = entry.manifest
    if about.get("format") != FORMAT:
        return f"its manifest has format {about.get('format')!r}"
    if about.get("cpu") != cpu.fingerprint:
        return f"it was built for another processor ({about.get('cpu_name', 'unknown')})"
    try:
        if entry.library.stat().st_size != about.get("size"):
            return "it is truncated"
        with entry.library.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        return f"it cannot be read ({error.strerror})"
    return "" if digest == about.get("sha256") else "its content has changed"


def _take(descriptor: int) -> bool | None:
    """Try to take a lock: whether it was free, or None where files cannot be locked."""
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
