"""Processors that this one can stand for, with the doubles of a register of each, and libraries compiled for them."""

import platform

from piaffe.ocp import CompiledProblem
from piaffe.solvers.native import build, library_for, load
from piaffe.solvers.native.build import EXPRESSION_FLAGS
from piaffe.solvers.native.cpu import this_cpu
from piaffe.solvers.native.library import KERNEL_FLAGS, Library
from piaffe.solvers.native.program import origin, program
from piaffe.solvers.native.texts import Origin, Texts

_LEVELS = {
    "-march=x86-64": (2, set()), "-march=x86-64-v3": (4, {"avx2", "bmi2", "fma"}),
    "-march=x86-64-v4": (8, {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}),
}  # fmt: skip
TARGETS: dict[str, int] = {
    flag: doubles
    for flag, (doubles, needed) in (_LEVELS if platform.machine() == "x86_64" else {}).items()
    if needed <= this_cpu().features
} or {this_cpu().native: 2}


def library_at(problem: CompiledProblem, target: str, width: int) -> Library:
    """Return a problem's library compiled for a target, with a number of lanes."""
    same = library_for(problem)[0]  # the same modes and transitions
    expressions, kernels = (
        tuple(target if flag == "{native}" else flag for flag in flags) for flags in (EXPRESSION_FLAGS, KERNEL_FLAGS)
    )

    def texts() -> Texts:
        made = program(same.modes, same.links)
        return Texts([*made.expressions, *made.kernels], made.headers, {name: kernels for name, _ in made.kernels})

    parts = [*origin(same.modes, same.links), *kernels]
    built = build(Origin(parts, texts), flags=expressions, width=width, label=f"tests, {target}")
    return Library(load(built), built, same.modes, same.links)
