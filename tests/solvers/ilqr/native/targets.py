"""Processors that this one can stand for, with the doubles of a register of each, and libraries compiled for them."""

import platform

from piaffe.codegen import build, load
from piaffe.codegen.build import EXPRESSION_FLAGS
from piaffe.codegen.cpu import this_cpu
from piaffe.codegen.sources import LazySources, Sources
from piaffe.ocp import CompiledProblem
from piaffe.solvers.ilqr.native.library import KERNEL_FLAGS, Library, library_for
from piaffe.solvers.ilqr.native.program import program, source_parts

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
    """Return a problem's library compiled for a target, with a vector width."""
    same = library_for(problem)[0]  # the same modes and transitions
    expressions, kernels = (
        tuple(target if flag == "{native}" else flag for flag in flags) for flags in (EXPRESSION_FLAGS, KERNEL_FLAGS)
    )

    def make() -> Sources:
        made = program(same.modes, same.transitions)
        return Sources([*made.expressions, *made.kernels], made.headers, {name: kernels for name, _ in made.kernels})

    parts = [*source_parts(same.modes, same.transitions), *kernels]
    built = build(LazySources(parts, make), flags=expressions, width=width, label=f"tests, {target}")
    return Library(load(built), built, same.modes, same.transitions)
