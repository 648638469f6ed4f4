"""C compilers: find those of this machine, identify them, and test whether they work."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from piaffe.errors import SolverError

from .cpu import this_cpu

Kind = Literal["gcc", "clang", "zig"]

ADVICE = "pip install 'piaffe[compiler]', or install gcc or clang"
_NAMES = ("cc", "gcc", "clang")
_VERSION_TIMEOUT_S = 30.0
_TRIAL_TIMEOUT_S = 180.0  # zig builds parts of its own library the first time
_TRIAL = """
#include <math.h>
typedef double vd __attribute__((vector_size(32)));
double piaffe_trial(double x) {
    vd a = {1.0, 2.0, 3.0, 4.0};
    a = a * a + x;
    return sqrt(a[0] + a[1] + a[2] + a[3]);
}
"""
_LOAD = """
import ctypes, sys
trial = ctypes.CDLL(sys.argv[1]).piaffe_trial
trial.argtypes, trial.restype = [ctypes.c_double], ctypes.c_double
sys.exit(trial(-1.5) != 24.0**0.5)
"""


NOEXEC = "failed to map segment from shared object"  # the loader's text for a file system that is mounted noexec


class NoCompilerError(SolverError):
    """No C compiler works on this machine."""


class NoCompilerWarning(UserWarning):
    """No C compiler works on this machine, so that NumPy code is used in place of compiled C."""


@dataclass(frozen=True)
class Compiler:
    """A C compiler.

    Args:
        command: its command line; more than one word if it needs arguments.
        kind: the compiler whose flags it accepts.
        version: the first line of its output for ``--version``.
    """

    command: tuple[str, ...]
    kind: Kind
    version: str

    @property
    def identity(self) -> str:
        """The compiler's properties that a compiled library depends on; its path is not one of them."""
        return "\n".join((self.kind, self.version, *self.command[1:]))

    @property
    def flags(self) -> tuple[str, ...]:
        """Flags that this kind needs for compiling and linking."""
        return ("-fno-sanitize=undefined", "-g0") if self.kind == "zig" else ()  # zig enables both by default

    def __str__(self) -> str:
        return self.version


def candidates() -> Iterator[Compiler]:
    """Yield the compilers of this machine, best first: ``CC`` alone if it is set; else cc, gcc, clang, ziglang.

    Raises:
        NoCompilerError: ``CC`` is set, but not to a compiler.
    """
    wanted = os.environ.get("CC", "").strip()
    if wanted:
        try:
            command = tuple(shlex.split(wanted))
        except ValueError:  # an open quotation mark
            command = (wanted,)
        compiler = identify(command)
        if compiler is None:
            raise _not_working(f"CC={wanted!r}", "a command that prints nothing for --version")
        yield compiler
        return
    seen = set()
    for name in _NAMES:
        path = shutil.which(name)
        compiler = identify((path,)) if path else None
        if compiler is not None and compiler.identity not in seen:
            seen.add(compiler.identity)
            yield compiler
    if find_spec("ziglang") is not None:
        compiler = identify((sys.executable, "-m", "ziglang", "cc"))
        if compiler is not None:
            yield compiler


def working() -> Compiler:
    """Return the first compiler that compiles vectors and links a library that can be loaded.

    Raises:
        NoCompilerError: there is none.
    """
    tried = []
    for compiler in candidates():
        fault = fault_of(compiler)
        if not fault:
            return compiler
        tried.append(f"{shlex.join(compiler.command)} ({fault})")
    if os.environ.get("CC", "").strip():
        raise _not_working(f"CC={os.environ['CC']!r}", tried[0])
    raise NoCompilerError(
        f"native backend: no C compiler - got {', '.join(tried) or 'none'}, expected cc, gcc or clang on the path, or "
        f"the package ziglang; {ADVICE}"
    )


def _not_working(where: str, got: str) -> NoCompilerError:
    return NoCompilerError(
        f"native backend: {where} does not work - got {got}, expected gcc or clang for this machine; set CC to one, "
        "or unset it"
    )


@cache
def identify(command: tuple[str, ...]) -> Compiler | None:
    """Return the compiler that a command calls; None if the command does not print a version."""
    output = _output((*command, "--version"))
    if not output:
        return None
    version = output.splitlines()[0].strip()
    if command[-2:] == ("ziglang", "cc") or (Path(command[0]).name == "zig" and command[1:2] == ("cc",)):
        release = _output((*command[:-1], "version")) or "?"
        return Compiler(command, "zig", f"zig {release.strip()}, {version}")
    if "Free Software Foundation" in output:
        name = " ".join(("gcc", *version.split()[1:]))  # gcc prints the name of its command first
        return Compiler(command, "gcc", name)
    return Compiler(command, "clang", version)


def _output(command: tuple[str, ...]) -> str:
    """Return the output of a command; empty if it fails."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=_VERSION_TIMEOUT_S,
            stdin=subprocess.DEVNULL, env={**os.environ, "LC_ALL": "C"},
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""


@cache
def fault_of(compiler: Compiler) -> str:
    """Return in a few words why a compiler does not work on this machine; empty if it works."""
    try:
        temporary = tempfile.TemporaryDirectory(prefix="piaffe-")
    except OSError as error:
        return f"no temporary folder: {error.strerror or error}"
    with temporary as folder:
        source, library = Path(folder, "trial.c"), Path(folder, "trial.so")
        source.write_text(_TRIAL, encoding="utf-8")
        flags = ("-O1", this_cpu().native, "-fPIC", "-shared", "-w", *compiler.flags)
        try:
            made = subprocess.run(
                [*compiler.command, *flags, str(source), "-o", str(library), "-lm"],
                capture_output=True, text=True, errors="replace", timeout=_TRIAL_TIMEOUT_S, stdin=subprocess.DEVNULL,
                env={**os.environ, "LC_ALL": "C", "TMPDIR": folder, "ZIG_LOCAL_CACHE_DIR": folder},
            )  # fmt: skip
            if made.returncode:
                return f"a small program does not compile: {first_lines(made.stderr, 1) or made.returncode}"
            loaded = subprocess.run(  # in a process of its own: code for another processor would kill this one
                [sys.executable, "-I", "-S", "-c", _LOAD, str(library)],
                capture_output=True, text=True, errors="replace", timeout=_TRIAL_TIMEOUT_S, stdin=subprocess.DEVNULL,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as error:
            return str(error)
    if NOEXEC in loaded.stderr:
        return ""  # programs in the temporary folder may not run; what the compiler makes may run elsewhere
    if loaded.returncode:
        last = loaded.stderr.strip().splitlines()[-1:]
        return f"its small program does not run: {last[0] if last else f'exit code {loaded.returncode}'}"
    return ""


def first_lines(output: str, count: int) -> str:
    """Return the first lines of a compiler's output, from the first line that contains an error."""
    lines = [line.rstrip() for line in output.splitlines() if line.strip()]
    begin = next((i for i, line in enumerate(lines) if "error" in line.lower() or "undefined" in line.lower()), 0)
    shown = lines[begin : begin + count]
    more = len(lines) - begin - len(shown)
    return "\n".join([*shown, f"... and {more} more lines"] if more > 0 and count > 1 else shown)
