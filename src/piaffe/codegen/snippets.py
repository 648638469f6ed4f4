"""Small pieces of C that plans wait for, where a compiler works; and C on several threads."""

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
    """Return a package's ``template/NAME.c``, compiled and loaded; None where no compiler works.

    Args:
        package: dotted name of the package.
        name: of the file, without its ending.
        label: what it is for, to be shown with the cache.
    """
    text = files(package).joinpath("template", f"{name}.c").read_text(encoding="utf-8")
    try:
        return load(build([(name, text)], flags=SOLVER_FLAGS, label=label))
    except NoCompilerError:
        return None


def pointer(array: np.ndarray) -> ct.c_void_p:
    """Return where an array's numbers are."""
    return ct.c_void_p(array.ctypes.data)


def side_by_side(run: Callable[[Part], None], parts: Sequence[Part], pool: Executor) -> None:
    """Run the first part on this thread and the others in the pool; all have ended when this returns or raises."""
    others = [pool.submit(run, part) for part in parts[1:]]
    try:
        run(parts[0])
    finally:  # interrupted or not: they write into memory that the next call uses
        wait(others)
    for other in others:
        other.result()
