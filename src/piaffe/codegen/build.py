"""From C texts to a shared library: compiled in parallel, or found in the cache."""

from __future__ import annotations

import ctypes
import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from piaffe import __version__
from piaffe.errors import SolverError

from .cache import LIBRARY, Cache, Entry
from .compilers import Compiler, candidates, working
from .cpu import Cpu, available_cores, this_cpu
from .processes import Runner
from .sources import Origin, Sources

VERSION = "2"
"""Part of every key: counted up when this module compiles differently."""

_EXACT = ("-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast")  # NaN, infinities and rounding as in IEEE 754
EXPRESSION_FLAGS = ("-O1", "-fexpensive-optimizations", *_EXACT, "{native}")
"""For generated straight-line code, in which more costs minutes and gains little."""
SOLVER_FLAGS = ("-O3", *_EXACT, "{native}")
"""For the templates, whose loops have constant bounds. ``{native}`` becomes the flag for this processor."""

Progress = Callable[[int, int, str], None]
"""Called with steps done, steps in all, and the name of what was done last; in the caller's thread."""


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
        texts = Sources(tuple(units), dict(headers or {}), dict(flags_per_unit or {}))
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
    made = origin.texts()
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


def _checked_width(width: int) -> int:
    if width not in (1, 2, 4, 8):
        raise SolverError(f"build: width - got {width}, expected 1, 2, 4 or 8; leave it out for this machine's")
    return width


def _written(flags: Sequence[str], width: int, cpu: Cpu) -> tuple[str, ...]:
    """Return flags as the compiler reads them."""
    wide = ("-mprefer-vector-width=512",) if width == 8 and cpu.machine == "x86_64" else ()
    return tuple(word for flag in flags for word in ((cpu.native, *wide) if flag == "{native}" else (flag,)))


def _compile(
    recipe: _Recipe, texts: Sources, compiler: Compiler, cpu: Cpu, folder: Path, progress: Progress | None
) -> Path:
    """Compile and link in a private folder; return the library's file in it."""
    told = progress or (lambda done, steps, name: None)
    for name, text in texts.headers.items():
        _write(folder / name, text)
    for name, text in texts.units:
        _write(folder / f"{name}.c", text)
    steps = len(texts.units) + 1
    told(0, steps, "")
    runner = Runner(compiler, folder)
    common = ("-std=gnu11", "-fPIC", "-w", f"-DPIAFFE_W={recipe.width}")
    flags = {name: _written(texts.flags_per_unit.get(name, recipe.flags), recipe.width, cpu) for name, _ in texts.units}
    longest_first = sorted(texts.units, key=lambda unit: -len(unit[1]))
    with ThreadPoolExecutor(min(len(texts.units), available_cores())) as pool:
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


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise SolverError(
            f"cache '{path.parent.parent.parent}': cannot be written - got {error.strerror or error}, expected room "
            "for C texts and a library; free some, or set PIAFFE_CACHE to another folder"
        ) from error
