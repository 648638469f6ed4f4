"""Libraries: the compiled solver for a set of modes, loaded once per process and shared by all problems with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

from piaffe.codegen import SOLVER_FLAGS, Built, LazySources, LoadedLibrary, Sources, build, load, this_cpu
from piaffe.ocp import CompiledProblem, LoweredMode, LoweredTransition

from .program import program, source_parts

KERNEL_FLAGS = (*SOLVER_FLAGS, *(("-mprefer-vector-width=512",) if this_cpu().machine == "x86_64" else ()))

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, eq=False)
class Library:
    """A loaded library, with its modes and transitions in the order of its tables."""

    loaded: LoadedLibrary
    built: Built
    modes: tuple[LoweredMode, ...]
    transitions: tuple[LoweredTransition, ...]


@dataclass(frozen=True)
class _Structure:
    """Modes and transitions, compared by identity: problems of the same structure share them."""

    modes: tuple[LoweredMode, ...]
    transitions: tuple[LoweredTransition, ...]
    width: int | None
    progress: Progress | None = field(compare=False)


def library_for(
    problem: CompiledProblem, *, width: int | None = None, progress: Progress | None = None
) -> tuple[Library, bool]:
    """Return the library for a problem's modes, and whether this call compiled it.

    Args:
        problem: the compiled problem.
        width: doubles per vector; by default the vector width of this processor.
        progress: called while the library compiles.
    """
    modes = tuple(dict.fromkeys(phase.mode for phase in problem.phases))
    transitions = tuple(dict.fromkeys(phase.transition for phase in problem.phases if phase.transition is not None))
    return library_of(modes, transitions, width=width, progress=progress)


def library_of(
    modes: tuple[LoweredMode, ...],
    transitions: tuple[LoweredTransition, ...],
    *,
    width: int | None = None,
    progress: Progress | None = None,
) -> tuple[Library, bool]:
    """Return the library of modes and transitions, and whether this call compiled it; see :func:`library_for`."""
    misses = _library.cache_info().misses
    library = _library(_Structure(modes, transitions, width, progress))
    return library, _library.cache_info().misses > misses and library.built.built


@lru_cache(maxsize=16)
def _library(structure: _Structure) -> Library:
    modes, transitions = structure.modes, structure.transitions

    def make() -> Sources:
        made = program(modes, transitions)
        return Sources(
            [*made.expressions, *made.kernels], made.headers, {name: KERNEL_FLAGS for name, _ in made.kernels}
        )

    built = build(
        LazySources([*source_parts(modes, transitions), *KERNEL_FLAGS], make),
        width=structure.width,
        label=" + ".join(dict.fromkeys(mode.model.name for mode in modes)),
        progress=structure.progress,
    )
    return Library(load(built), built, modes, transitions)
