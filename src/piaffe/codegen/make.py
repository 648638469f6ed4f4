"""Run ``make`` in a project's folder with the compiler of this machine."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from pathlib import Path

from piaffe.errors import SolverError

from .compilers import Compiler, first_lines, working
from .cpu import available_cores

_LINES = 12  # of the output, shown in the error


def run_make(folder: Path, *words: str) -> str:
    """Return what ``make`` prints.

    Args:
        folder: of the Makefile.
        words: targets and variables.

    Raises:
        SolverError: there is no ``make``, or it fails.
        NoCompilerError: there is no compiler.
    """
    program = shutil.which("make")
    if program is None:
        raise SolverError(f"make '{folder}': there is no make - got no such command on the path; install make")
    command = [program, "-C", str(folder), f"-j{available_cores()}", *made_with(working()), *words]
    free = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", env=free, check=False)
    if done.returncode:
        said = "\n".join(done.stdout.splitlines()[-_LINES:] + first_lines(done.stderr, _LINES).splitlines())
        raise SolverError(
            f"make '{folder}': it fails - got exit code {done.returncode} and\n{said}\nexpected success; see what it "
            f"says (the command was {shlex.join(command)})"
        )
    return done.stdout


def made_with(compiler: Compiler) -> list[str]:
    """Return the variables of ``make`` that choose a compiler and its archiver."""
    found = [f"CC={shlex.join([*compiler.command, *compiler.flags])}"]
    if compiler.kind == "zig":
        found.append(f"AR={shlex.join([*compiler.command[:-1], 'ar'])}")
    return found
