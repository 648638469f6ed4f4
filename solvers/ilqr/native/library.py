"""Libraries: the compiled solver of a set of modes, built or found once per process, shared by all its problems."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

from piaffe.codegen import SOLVER_FLAGS, Built, LazySources, Sources, build, load, this_cpu
from piaffe.ocp import CompiledProblem, LoweredMode, LoweredTransition

from .program import origin, program

KERNEL_FLAGS = (*SOLVER_FLAGS, *(("-mprefer-vector-width=512",) if this_cpu().machine == "x86_64" else ()))

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, eq=False)
class Library:
    """A loaded library with the modes and transitions in the order of its tables."""

    loaded: ctypes.CDLL
    built: Built
    modes: tuple[LoweredMode, ...]
    links: tuple[LoweredTransition, ...]


@dataclass(frozen=True)
class _Structure:
    """Modes and transitions, by identity: problems of equal structure share them."""

    modes: tuple[LoweredMode, ...]
    links: tuple[LoweredTransition, ...]
    width: int | None
    progress: Progress | None = field(compare=False)


def library_for(
    problem: CompiledProblem, *, width: int | None = None, progress: Progress | None = None
) -> tuple[Library, bool]:
    """Return the library of a problem's modes, and whether this call had to compile it.

    Args:
        problem: the compiled problem.
        width: lanes; as this processor likes it by default.
        progress: called while compiling.
    """
    modes = tuple(dict.fromkeys(phase.mode for phase in problem.phases))
    links = tuple(dict.fromkeys(phase.transition for phase in problem.phases if phase.transition is not None))
    misses = _library.cache_info().misses
    library = _library(_Structure(modes, links, width, progress))
    return library, _library.cache_info().misses > misses and library.built.built


@lru_cache(maxsize=16)
def _library(structure: _Structure) -> Library:
    modes, links = structure.modes, structure.links

    def texts() -> Sources:
        made = program(modes, links)
        return Sources(
            [*made.expressions, *made.kernels], made.headers, {name: KERNEL_FLAGS for name, _ in made.kernels}
        )

    built = build(
        LazySources([*origin(modes, links), *KERNEL_FLAGS], texts),
        width=structure.width,
        label=" + ".join(dict.fromkeys(mode.model.name for mode in modes)),
        progress=structure.progress,
    )
    return Library(load(built), built, modes, links)
