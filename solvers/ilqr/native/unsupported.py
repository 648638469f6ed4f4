"""Name the term whose expression has no form in the generated C code, such as an interpolation table."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as cs

from piaffe.codegen import UnsupportedOperationError, simd
from piaffe.errors import ProblemError
from piaffe.ocp import CompiledPhase, CompiledProblem, owner_of


def refused(problem: CompiledProblem, error: UnsupportedOperationError) -> ProblemError:
    """Return the error of a problem with such an expression; it names the term, the file and the line."""
    where = next((place for phase in problem.phases for place in _places(problem, phase)), None)
    if where is None:
        phase = problem.phases[0]
        where = f"dynamics of model '{phase.mode.model.name}' ({phase.interval.phase.source})"
    what = "a call of another function (casadi.interpolant is one)" if error.operation == "OP_CALL" else error.operation
    return ProblemError(
        f"{where}: an expression has no form in C - got {what}, expected arithmetic, comparisons, selections or "
        "functions of the C library; write it with these (a polynomial, casadi.if_else), or solve with backend='numpy'"
    )


def _places(problem: CompiledProblem, phase: CompiledPhase) -> Iterator[str]:
    """Yield the owners of the rows of a phase that have such an operation."""
    for group, kinds in (("stage", ("residual", "g", "h", "x_next")), ("terminal", ("residual", "g", "h"))):
        function = phase.mode.functions[group]
        inputs = [cs.SX.sym(name, function.sparsity_in(i)) for i, name in enumerate(function.name_in())]
        outputs = dict(zip(function.name_out(), function.call(inputs), strict=True))
        for kind in kinds:
            for row in range(outputs[kind].numel() if kind in outputs else 0):
                if simd.unsupported(cs.Function("row", inputs, [outputs[kind][row]])):
                    yield owner_of(problem, phase, group, kind, row)
