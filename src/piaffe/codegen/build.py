"""Build a shared library from C sources: compile them in parallel, or find the library in the cache."""

from __future__ import annotations

import ctypes
import hashlib
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

from piaffe import __version__
from piaffe.errors import SolverError

from .cache import LIBRARY, Cache, Entry
from .compilers import NOEXEC, Compiler, candidates, working
from .cpu import Cpu, available_cores, this_cpu
from .processes import CompileError, Runner
from .sources import LazySources, Sources
from .trust import CacheError, NoFolderError, is_private, private_folder

VERSION = "2"
"""Part of every key; increase it when a change of this module changes the compiled code."""

_EXACT = ("-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast")  # NaN, infinities and rounding as in IEEE 754
EXPRESSION_FLAGS = ("-O1", "-fexpensive-optimizations", *_EXACT, "{native}")
"""Flags for generated straight-line code; higher optimisation takes minutes and makes it hardly faster.

``{native}`` is replaced by the flag for this processor.
"""
SOLVER_FLAGS = ("-O3", *_EXACT, "{native}")
"""Flags for the templates, whose loops have constant bounds."""

_FULL = ("No space left on device", "Disk quota exceeded")  # in the output of a compiler whose disk is full

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
        cache: the cache; by default the user's, and a temporary folder, with a warning, if that cannot be written.

    Raises:
        CompileError: a unit does not compile, or the link fails.
        NoCompilerError: no compiler works on this machine, or there is no folder for the library.
        SolverError: the arguments contradict each other.
        CacheError: the cache that was passed cannot be written.
    """
    began = time.perf_counter()
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
    checked = _checked_width(this_cpu().vector_width if width is None else width)
    recipe = _Recipe(sources, tuple(flags), tuple(link), checked, version)
    if cache is not None:
        return _built(recipe, cache, label, progress, began)
    cache = Cache()
    try:
        return _built(recipe, cache, label, progress, began)
    except CacheError as error:
        if is_private(cache.folder):
            raise _no_folder(error) from error
        other = Cache(private_folder(str(error)))
    try:
        return _built(recipe, other, label, progress, began)
    except CacheError as error:
        raise _no_folder(error) from error


def _no_folder(error: CacheError) -> NoFolderError:
    return NoFolderError(f"native backend: no folder for compiled libraries - {error}")


def _built(recipe: _Recipe, cache: Cache, label: str, progress: Progress | None, began: float) -> Built:
    """Return a library from a cache, or compile it into the cache."""
    cpu = this_cpu()

    def result(entry: Entry, key: str, compiler: Compiler, built: bool) -> Built:
        seconds = time.perf_counter() - began
        return Built(entry.library, built, seconds, recipe.width, compiler.version, key, recipe.sources, recipe.flags)

    for compiler in candidates():  # before any compiler is tested, because a test takes longer than this search
        key = recipe.key(compiler, cpu)
        if (entry := cache.find(key, cpu)) is not None:
            return result(entry, key, compiler, False)
    compiler = working()
    key = recipe.key(compiler, cpu)
    made = recipe.sources.make()
    steps = len(made.units) + 1

    def waiting() -> None:
        if progress is not None:
            progress(0, steps, "another process is building this")

    with cache.building(key, waiting) as folder:
        if (entry := cache.find(key, cpu)) is not None:  # another process has built it in the meantime
            return result(entry, key, compiler, False)
        try:
            library = _compile(recipe, made, compiler, cpu, folder, progress)
        except CompileError as error:
            if any(text in error.output for text in _FULL):
                raise CacheError(
                    f"cache '{cache.folder}': cannot be written - got a full disk while compiling, expected free "
                    "space; free some, or set PIAFFE_CACHE to another folder"
                ) from error
            raise
        about = {
            "cpu": cpu.fingerprint, "cpu_name": cpu.name, "compiler": compiler.version, "width": recipe.width,
            "units": len(made.units), "label": label, "seconds": time.perf_counter() - began, "piaffe": __version__,
        }  # fmt: skip
        return result(cache.store(key, library, about), key, compiler, True)


def load(built: Built) -> LoadedLibrary:
    """Load a library, after a check that it is complete and built for this processor.

    Raises:
        SolverError: it is damaged, built for another processor or missing, or it cannot be loaded.
        NoFolderError: programs may run neither in its folder nor in a temporary one.
    """
    entry = Cache(built.path.parent.parent).find(built.key, this_cpu())
    if entry is None:
        got = "a file that is damaged or was built for another processor" if built.path.exists() else "no file"
        raise SolverError(f"library '{built.path}': not loaded - got {got}, expected the built file; build it again")
    try:
        library = LoadedLibrary(str(built.path))
    except OSError as error:
        if NOEXEC not in str(error):
            raise SolverError(
                f"library '{built.path}': not loaded - got {error}, expected a shared library for this machine; remove "
                "it (piaffe cache --clear) and build it again"
            ) from error
        library = _load_elsewhere(entry)
    library.built = built
    return library


def _load_elsewhere(entry: Entry) -> LoadedLibrary:
    """Load a copy of a library in the temporary folder of this process: its own folder is mounted noexec.

    Raises:
        NoFolderError: the copy cannot be written or loaded, either.
    """
    advice = "set PIAFFE_CACHE to a folder on a file system without 'noexec'"
    why = f"programs in the cache '{entry.folder.parent}' may not run (noexec); {advice}"
    cache = Cache(private_folder(why))
    key = entry.folder.name
    try:
        copy = cache.find(key, this_cpu())
        if copy is None:
            with cache.building(key) as folder:
                shutil.copyfile(entry.library, folder / "copy.so")
                copy = cache.store(key, folder / "copy.so", entry.manifest)
        return LoadedLibrary(str(copy.library))
    except (CacheError, OSError) as error:
        raise NoFolderError(
            f"native backend: no folder to load compiled libraries from - got {error}, expected a folder without "
            f"'noexec'; {advice}"
        ) from error


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
        raise CacheError(
            f"cache '{path.parent.parent.parent}': cannot be written - got {error.strerror or error}, expected space "
            "for C sources and a library; free some space, or set PIAFFE_CACHE to another folder"
        ) from error
