"""Small pieces of C that plans wait for, where a compiler works."""

from __future__ import annotations

import ctypes as ct
from importlib.resources import files

import numpy as np

from piaffe.solvers.native import NoCompilerError, build, load
from piaffe.solvers.native.build import SOLVER_FLAGS


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
