"""Build a shared library from C sources: compile them in parallel, or find the library in the cache."""

from __future__ import annotations

import ctypes
import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

from piaffe import __version__
from piaffe.errors import SolverError

from .cache import LIBRARY, Cache, Entry
from .compilers import Compiler, candidates, working
from .cpu import Cpu, available_cores, this_cpu
from .processes import Runner
from .sources import LazySources, Sources

VERSION = "2"
"""Part of every key; increase it when a change of this module changes the compiled code."""

_EXACT = ("-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast")  # NaN, infinities and rounding as in IEEE 754
EXPRESSION_FLAGS = ("-O1", "-fexpensive-optimizations", *_EXACT, "{native}")
"""Flags for generated straight-line code; higher optimisation takes minutes and makes it hardly faster.

``{native}`` is replaced by the flag for this processor.
"""
SOLVER_FLAGS = ("-O3", *_EXACT, "{native}")
"""Flags for the templates, whose loops have constant bounds."""

Progress = Callable[[int, int, str], None]
"""Called with the number of finished steps, the number of all steps, and the name of the last finished step.

It runs in the caller's thread.
"""


@dataclass(frozen=True)
class Built:
    """The result of :func:`build`.

    Args:
        path: the shared library.
        built: whether this call compiled it; False if it was in the cache.
        seconds: duration of the call [s].
        width: doubles per vector, ``PIAFFE_W``.
        compiler: version of the compiler.
        key: digest of the library's sources, flags, compiler and processor; its name in the cache.
        sources: what it is compiled from.
        flags: flags of the units without their own.
    """

    path: Path
    built: bool
    seconds: float
    width: int
    compiler: str
    key: str
    sources: LazySources = field(repr=False, compare=False)
    flags: tuple[str, ...] = ()


class LoadedLibrary(ctypes.CDLL):
    """A loaded library, which knows how it was built."""

    built: Built


@dataclass(frozen=True)
class _Recipe:
    """Everything that the content of a library depends on, except the compiler and the processor."""

    sources: LazySources
    flags: tuple[str, ...]
    link: tuple[str, ...]
    width: int
    version: str

    def key(self, compiler: Compiler, cpu: Cpu) -> str:
        """Return the digest that names the library in the cache."""
        digest = hashlib.sha256()
        parts = [
            VERSION, self.version, str(self.width), compiler.identity, *compiler.flags, cpu.fingerprint, *self.link,
            "flags", *self.flags, *self.sources.parts,
        ]  # fmt: skip
        for part in parts:
            encoded = part.encode()
            digest.update(b"%d:" % len(encoded) + encoded)  # with its length, so that different lists differ
        return digest.hexdigest()


def build(
    units: Sequence[tuple[str, str]] | LazySources,
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
    """Return a shared library of some translation units, from the cache or compiled by this call.

    Args:
        units: name (an identifier) and C source of each unit; or lazy sources, headers included.
        headers: file name and text of the headers that the units include.
        flags: flags of every unit without its own; ``{native}`` is replaced by the flag for this processor.
        flags_per_unit: flags by unit, in place of ``flags``.
        link: further arguments of the linker.
        width: doubles per vector, the macro ``PIAFFE_W`` of the sources; by default the vector width of this processor.
        version: of the template; part of the key.
        label: purpose of the library, shown in the list of the cache.
        progress: called before the first unit, and after each unit.
        cache: the cache; by default the user's.

    Raises:
        CompileError: a unit does not compile, or the link fails.
        NoCompilerError: no compiler works on this machine.
        SolverError: the arguments contradict each other, or the cache cannot be written.
    """
    began = time.perf_counter()
    cpu = this_cpu()
    cache = cache or Cache()
    if isinstance(units, LazySources):
        if headers or flags_per_unit:
            raise SolverError(
                "build: headers or flags beside lazy sources - got them as arguments, expected none; put them into the "
                "sources"
            )
        sources = units
    else:
        given = Sources(tuple(units), dict(headers or {}), dict(flags_per_unit or {}))
        sources = LazySources(given.parts, lambda: given)
    checked = _checked_width(cpu.vector_width if width is None else width)
    recipe = _Recipe(sources, tuple(flags), tuple(link), checked, version)

    def result(entry: Entry, key: str, compiler: Compiler, built: bool) -> Built:
        seconds = time.perf_counter() - began
        return Built(entry.library, built, seconds, recipe.width, compiler.version, key, recipe.sources, recipe.flags)

    for compiler in candidates():  # before any compiler is tested, because a test takes longer than this search
        key = recipe.key(compiler, cpu)
        if (entry := cache.find(key, cpu)) is not None:
            return result(entry, key, compiler, False)
    compiler = working()
    key = recipe.key(compiler, cpu)
    made = sources.make()
    steps = len(made.units) + 1

    def waiting() -> None:
        if progress is not None:
            progress(0, steps, "another process is building this")

    with cache.building(key, waiting) as folder:
        if (entry := cache.find(key, cpu)) is not None:  # another process has built it in the meantime
            return result(entry, key, compiler, False)
        library = _compile(recipe, made, compiler, cpu, folder, progress)
        about = {
            "cpu": cpu.fingerprint, "cpu_name": cpu.name, "compiler": compiler.version, "width": recipe.width,
            "units": len(made.units), "label": label, "seconds": time.perf_counter() - began, "piaffe": __version__,
        }  # fmt: skip
        return result(cache.store(key, library, about), key, compiler, True)


def load(built: Built) -> LoadedLibrary:
    """Load a library, after a check that it is complete and built for this processor.

    Raises:
        SolverError: it is damaged, built for another processor or missing, or it cannot be loaded.
    """
    if Cache(built.path.parent.parent).find(built.key, this_cpu()) is None:
        got = "a file that is damaged or was built for another processor" if built.path.exists() else "no file"
        raise SolverError(f"library '{built.path}': not loaded - got {got}, expected the built file; build it again")
    try:
        library = LoadedLibrary(str(built.path))
    except OSError as error:
        raise SolverError(
            f"library '{built.path}': not loaded - got {error}, expected a shared library that can be executed; set "
            "PIAFFE_CACHE to a folder on a file system without 'noexec'"
        ) from error
    library.built = built
    return library


def _checked_width(width: int) -> int:
    if width not in (1, 2, 4, 8):
        raise SolverError(
            f"build: width is not supported - got {width}, expected 1, 2, 4 or 8; leave it out for this processor's"
        )
    return width


def _expanded(flags: Sequence[str], width: int, cpu: Cpu) -> tuple[str, ...]:
    """Return flags with ``{native}`` replaced."""
    wide = ("-mprefer-vector-width=512",) if width == 8 and cpu.machine == "x86_64" else ()
    return tuple(word for flag in flags for word in ((cpu.native, *wide) if flag == "{native}" else (flag,)))


def _compile(
    recipe: _Recipe, sources: Sources, compiler: Compiler, cpu: Cpu, folder: Path, progress: Progress | None
) -> Path:
    """Compile and link in a private folder; return the path of the library in it."""
    report = progress or (lambda done, steps, name: None)
    for name, text in sources.headers.items():
        _write(folder / name, text)
    for name, text in sources.units:
        _write(folder / f"{name}.c", text)
    steps = len(sources.units) + 1
    report(0, steps, "")
    runner = Runner(compiler, folder)
    common = ("-std=gnu11", "-fPIC", "-w", f"-DPIAFFE_W={recipe.width}")
    flags = {
        name: _expanded(sources.flags_per_unit.get(name, recipe.flags), recipe.width, cpu) for name, _ in sources.units
    }
    longest_first = sorted(sources.units, key=lambda unit: -len(unit[1]))
    with ThreadPoolExecutor(min(len(sources.units), available_cores())) as pool:
        try:
            jobs = {
                pool.submit(runner, name, (*common, *flags[name], "-c", f"{name}.c", "-o", f"{name}.o")): name
                for name, _ in longest_first
            }
            for done, job in enumerate(as_completed(jobs), start=1):
                job.result()
                report(done, steps, jobs[job])
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            runner.stop()
            raise
    # undefined symbols are errors of the link, not of loading; with a sanitizer, the main program defines some
    complete = () if any(flag.startswith("-fsanitize") for flag in recipe.link) else ("-Wl,-z,defs",)
    objects = [f"{name}.o" for name, _ in sources.units]
    runner("link", ("-shared", "-o", LIBRARY, *objects, *complete, *recipe.link))
    report(steps, steps, "link")
    return folder / LIBRARY


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise SolverError(
            f"cache '{path.parent.parent.parent}': cannot be written - got {error.strerror or error}, expected space "
            "for C sources and a library; free some space, or set PIAFFE_CACHE to another folder"
        ) from error
