"""Starting the native backend: a machine for a problem, or a clear notice that there is no compiler."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Literal

from piaffe.ocp import CompiledProblem

from ..options import Options
from .compilers import NoCompilerError
from .library import library_for
from .machine import Machine

Backend = Literal["native", "numpy"]


class NoCompilerWarning(UserWarning):
    """The native backend was asked for, and no C compiler works here."""


def native_machine(
    problem: CompiledProblem, options: Options, building: Callable[[int, int, str], None] | None = None
) -> Machine | None:
    """Return a machine that solves a problem in C; None, with one warning, where no compiler works."""
    try:
        library, _ = library_for(problem, progress=building)
    except NoCompilerError as error:
        warnings.warn(f"solving in NumPy, about ten times slower: {error}", NoCompilerWarning, stacklevel=3)
        return None
    return Machine(problem, library, options)
