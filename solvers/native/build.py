"""From C texts to a shared library: compiled in parallel, or found in the cache."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import re
import shlex
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

from piaffe import __version__
from piaffe.errors import SolverError

from .cache import LIBRARY, Cache, Entry
from .compilers import Compiler, candidates, first_lines, working
from .cpu import Cpu, this_cpu

VERSION = "2"
"""Part of every key: counted up when this module compiles differently."""

_EXACT = ("-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast")  # NaN, infinities and rounding as in IEEE 754
EXPRESSION_FLAGS = ("-O1", "-fexpensive-optimizations", *_EXACT, "{native}")
"""For generated straight-line code, in which more costs minutes and gains little."""
SOLVER_FLAGS = ("-O3", *_EXACT, "{native}")
"""For the templates, whose loops have constant bounds. ``{native}`` becomes the flag for this processor."""

_LINES = 12  # of a compiler's message
_NAME = re.compile(r"[A-Za-z_]\w*")
_HEADER = re.compile(r"\w[\w.-]*")

Progress = Callable[[int, int, str], None]
"""Called with steps done, steps in all, and the name of what was done last; in the caller's thread."""


class CompileError(SolverError):
    """The compiler refuses a text.

    Args:
        text: what to tell.
        unit: name of the translation unit, or ``"link"``.
        said: all that the compiler said.
    """

    def __init__(self, text: str, unit: str, said: str) -> None:
        self.unit, self.said = unit, said
        super().__init__(text)


@dataclass(frozen=True)
class Built:
    """A library to load.

    Args:
        path: the shared library.
        built: whether it was compiled now; else it was in the cache.
        seconds: how long that took.
        width: doubles per vector, ``PIAFFE_W``.
        compiler: the version of who compiled it.
        key: of its content.
    """

    path: Path
    built: bool
    seconds: float
    width: int
    compiler: str
    key: str


@dataclass(frozen=True)
class Texts:
    """C texts of a library.

    Args:
        units: name (an identifier) and text of each translation unit.
        headers: file name and text of what they include.
        flags_per_unit: flags by unit, instead of those for all.
    """

    units: Sequence[tuple[str, str]]
    headers: Mapping[str, str] = field(default_factory=dict)
    flags_per_unit: Mapping[str, Sequence[str]] = field(default_factory=dict)

    @property
    def parts(self) -> list[str]:
        """All of them, as one list."""
        parts = []
        for name, text in self.units:
            parts += ["unit", name, text, *self.flags_per_unit.get(name, ("as all",))]
        for name in sorted(self.headers):
            parts += ["header", name, self.headers[name]]
        return parts


@dataclass(frozen=True)
class Origin:
    """Texts that are made only if no library of them is kept, and what they are made from.

    Args:
        parts: what the texts follow from, whatever it is: equal parts make equal texts.
        texts: makes them.
    """

    parts: Sequence[str]
    texts: Callable[[], Texts]


@dataclass(frozen=True)
class _Recipe:
    """All that a library is made from, but for the compiler and the processor."""

    origin: Origin
    flags: tuple[str, ...]
    link: tuple[str, ...]
    width: int
    version: str

    def key(self, compiler: Compiler, cpu: Cpu) -> str:
        """Return the digest under which the library is kept."""
        digest = hashlib.sha256()
        parts = [
            VERSION, self.version, str(self.width), compiler.identity, *compiler.flags, cpu.fingerprint, *self.link,
            "flags", *self.flags, *self.origin.parts,
        ]  # fmt: skip
        for part in parts:
            encoded = part.encode()
            digest.update(b"%d:" % len(encoded) + encoded)  # the length, lest two lists read the same
        return digest.hexdigest()


def build(
    units: Sequence[tuple[str, str]] | Origin,
    *,
    headers: Mapping[str, str] | None = None,
    flags: Sequence[str] = EXPRESSION_FLAGS,
    flags_per_unit: Mapping[str, Sequence[str]] | None = None,
    link: Sequence[str] = ("-lm",),
    width: int | None = None,
    version: str = "",
    label: str = "",
    progress: Progress | None = None,
    cache: Cache | None = None,
) -> Built:
    """Return a shared library of some translation units, from the cache or compiled now.

    Args:
        units: name (an identifier) and C text of each; or where all texts come from, headers included.
        headers: file name and text of what they include.
        flags: for every unit that has none of its own; ``{native}`` stands for the flag for this processor.
        flags_per_unit: flags by unit, instead of ``flags``.
        link: further arguments when linking.
        width: doubles per vector, which the texts read as ``PIAFFE_W``; as this processor likes it by default.
        version: of the template; part of the key.
        label: what the library is for, to be shown with the cache.
        progress: called after each unit, and before the first.
        cache: where to keep libraries; the user's by default.

    Raises:
        CompileError: the compiler refuses a unit, or the link.
        NoCompilerError: no compiler works here.
        SolverError: the arguments are at odds, or the cache cannot be written.
    """
    began = time.perf_counter()
    cpu = this_cpu()
    cache = cache or Cache()
    if isinstance(units, Origin):
        if headers or flags_per_unit:
            raise SolverError(
                "build: headers and flags of an origin's texts - got them as arguments, expected none; let its texts "
                "have them"
            )
        origin = units
    else:
        texts = _checked(Texts(tuple(units), dict(headers or {}), dict(flags_per_unit or {})))
        origin = Origin(texts.parts, lambda: texts)
    recipe = _Recipe(origin, tuple(flags), tuple(link), _checked_width(cpu.lanes if width is None else width), version)

    def result(entry: Entry, key: str, compiler: Compiler, built: bool) -> Built:
        seconds = time.perf_counter() - began
        return Built(entry.library, built, seconds, recipe.width, compiler.version, key)

    for compiler in candidates():  # before any is put to the test, which takes longer than to find
        key = recipe.key(compiler, cpu)
        if (entry := cache.find(key, cpu)) is not None:
            return result(entry, key, compiler, False)
    compiler = working()
    key = recipe.key(compiler, cpu)
    made = _checked(origin.texts())
    steps = len(made.units) + 1

    def waiting() -> None:
        if progress is not None:
            progress(0, steps, "another process is building this")

    with cache.building(key, waiting) as folder:
        if (entry := cache.find(key, cpu)) is not None:  # by whom we have waited for
            return result(entry, key, compiler, False)
        library = _compile(recipe, made, compiler, cpu, folder, progress)
        about = {
            "cpu": cpu.fingerprint, "cpu_name": cpu.name, "compiler": compiler.version, "width": recipe.width,
            "units": len(made.units), "label": label, "seconds": time.perf_counter() - began, "piaffe": __version__,
        }  # fmt: skip
        return result(cache.store(key, library, about), key, compiler, True)


def load(built: Built) -> ctypes.CDLL:
    """Load a library, after a last look at whether it is whole and made for this processor.

    Raises:
        SolverError: it is not, or it is gone.
    """
    if Cache(built.path.parent.parent).find(built.key, this_cpu()) is None:
        got = "one that is damaged or was made for another processor" if built.path.exists() else "no file"
        raise SolverError(f"library '{built.path}': not loaded - got {got}, expected what was built; build it again")
    try:
        return ctypes.CDLL(str(built.path))
    except OSError as error:
        raise SolverError(
            f"library '{built.path}': not loaded - got {error}, expected a shared library that may be executed; set "
            "PIAFFE_CACHE to a folder on a file system without 'noexec'"
        ) from error


def _checked(texts: Texts) -> Texts:
    """Return texts; raise if names are odd or at odds."""
    names = [name for name, _ in texts.units]
    odd = [name for name in names if not _NAME.fullmatch(name)] + [n for n in texts.headers if not _HEADER.fullmatch(n)]
    if not names or odd or len(set(names)) < len(names):
        raise SolverError(
            f"build: names of units and headers - got {odd or names}, expected at least one unit, each with a plain "
            "name of its own; name them so"
        )
    if unknown := sorted(set(texts.flags_per_unit) - set(names)):
        raise SolverError(f"build: flags_per_unit - got {unknown}, expected names of units {names}; correct the names")
    return texts


def _checked_width(width: int) -> int:
    if width not in (1, 2, 4, 8):
        raise SolverError(f"build: width - got {width}, expected 1, 2, 4 or 8; leave it out for this machine's")
    return width


def _written(flags: Sequence[str], width: int, cpu: Cpu) -> tuple[str, ...]:
    """Return flags as the compiler reads them."""
    wide = ("-mprefer-vector-width=512",) if width == 8 and cpu.machine == "x86_64" else ()
    return tuple(word for flag in flags for word in ((cpu.native, *wide) if flag == "{native}" else (flag,)))


def _compile(
    recipe: _Recipe, texts: Texts, compiler: Compiler, cpu: Cpu, folder: Path, progress: Progress | None
) -> Path:
    """Compile and link in a private folder; return the library's file in it."""
    told = progress or (lambda done, steps, name: None)
    for name, text in texts.headers.items():
        _write(folder / name, text)
    for name, text in texts.units:
        _write(folder / f"{name}.c", text)
    steps = len(texts.units) + 1
    told(0, steps, "")
    runner = _Runner(compiler, folder)
    common = ("-std=gnu11", "-fPIC", "-w", f"-DPIAFFE_W={recipe.width}")
    flags = {name: _written(texts.flags_per_unit.get(name, recipe.flags), recipe.width, cpu) for name, _ in texts.units}
    longest_first = sorted(texts.units, key=lambda unit: -len(unit[1]))
    with ThreadPoolExecutor(min(len(texts.units), _cores())) as pool:
        try:
            jobs = {
                pool.submit(runner, name, (*common, *flags[name], "-c", f"{name}.c", "-o", f"{name}.o")): name
                for name, _ in longest_first
            }
            for done, job in enumerate(as_completed(jobs), start=1):
                job.result()
                told(done, steps, jobs[job])
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            runner.stop()
            raise
    # what is missing is to show now, not when the library is loaded; a sanitizer comes with the program
    whole = () if any(flag.startswith("-fsanitize") for flag in recipe.link) else ("-Wl,-z,defs",)
    objects = [f"{name}.o" for name, _ in texts.units]
    runner("link", ("-shared", "-o", LIBRARY, *objects, *whole, *recipe.link))
    told(steps, steps, "link")
    return folder / LIBRARY


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _kill(process: subprocess.Popen[str]) -> None:
    """Kill a compiler and what it has started; it leads a group of its own."""
    if process.returncode is None:
        with contextlib.suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise SolverError(
            f"cache '{path.parent.parent.parent}': cannot be written - got {error.strerror or error}, expected room "
            "for C texts and a library; free some, or set PIAFFE_CACHE to another folder"
        ) from error


@dataclass
class _Runner:
    """Runs compilers in a folder, from several threads, until it is stopped."""

    compiler: Compiler
    folder: Path
    stopped: bool = False
    _running: set[subprocess.Popen[str]] = field(default_factory=set)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __call__(self, unit: str, arguments: Sequence[str]) -> None:
        """Run the compiler.

        Raises:
            CompileError: it fails.
        """
        command = [*self.compiler.command, *self.compiler.flags, *arguments]
        own = str(self.folder)  # for what compilers leave when they are killed
        with self._lock:
            if self.stopped:
                return
            try:
                process = subprocess.Popen(
                    command, cwd=self.folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT, text=True, errors="replace", start_new_session=True,
                    env={**os.environ, "LC_ALL": "C", "TMPDIR": own, "ZIG_LOCAL_CACHE_DIR": own},
                )  # fmt: skip
            except OSError as error:
                raise self._error(unit, command, str(error)) from error
            self._running.add(process)
        try:
            said, _ = process.communicate()
        except BaseException:  # interrupted while linking, which this thread does itself
            _kill(process)
            process.wait()
            raise
        finally:
            with self._lock:
                self._running.discard(process)
        if process.returncode and not self.stopped:
            killed = f"killed by {signal.Signals(-process.returncode).name}" if process.returncode < 0 else ""
            raise self._error(unit, command, said.strip() or killed or f"exit code {process.returncode}")

    def stop(self) -> None:
        """Kill every compiler that runs, with what it has started; start no other."""
        with self._lock:
            self.stopped = True
            for process in self._running:
                _kill(process)

    def _error(self, unit: str, command: Sequence[str], said: str) -> CompileError:
        return CompileError(
            f"native backend, unit '{unit}': {self.compiler.version} refuses it - got\n{first_lines(said, _LINES)}\n"
            f"expected no error; set CC to another compiler, or use backend=\"numpy\"\n(it ran {shlex.join(command)})",
            unit, said,
        )  # fmt: skip
