"""Small C files for code that is too slow in NumPy, and functions that run C code on several threads."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, wait
from importlib.resources import files
from typing import TypeVar

import numpy as np

from .build import SOLVER_FLAGS, build, load
from .compilers import NoCompilerError

Part = TypeVar("Part")


def c_library(package: str, name: str, label: str) -> ct.CDLL | None:
    """Return a package's ``template/NAME.c``, compiled and loaded; None if no compiler works.

    Args:
        package: dotted name of the package.
        name: name of the file, without its ending.
        label: purpose of the library, shown in the list of the cache.
    """
    text = files(package).joinpath("template", f"{name}.c").read_text(encoding="utf-8")
    try:
        return load(build([(name, text)], flags=SOLVER_FLAGS, label=label))
    except NoCompilerError:
        return None


def pointer(array: np.ndarray) -> ct.c_void_p:
    """Return the address of an array's numbers."""
    return ct.c_void_p(array.ctypes.data)


def run_in_parallel(run: Callable[[Part], None], parts: Sequence[Part], pool: Executor) -> None:
    """Call ``run`` for the first part in this thread and for the others in the pool.

    All calls have ended when this function returns or raises.
    """
    others = [pool.submit(run, part) for part in parts[1:]]
    try:
        run(parts[0])
    finally:  # after an interrupt, too: they write into memory that the next call uses
        wait(others)
    for other in others:
        other.result()
