"""CasADi functions in the form that solvers use: dense columns and sparse matrices."""

from __future__ import annotations

import casadi as cs

_SMOOTH = {
    cs.OP_INPUT, cs.OP_CONST, cs.OP_OUTPUT, cs.OP_ASSIGN, cs.OP_ADD, cs.OP_SUB, cs.OP_MUL, cs.OP_DIV, cs.OP_NEG,
    cs.OP_SQ, cs.OP_TWICE, cs.OP_INV, cs.OP_SIN, cs.OP_COS, cs.OP_EXP,
}  # fmt: skip
"""Operations whose derivatives are finite wherever their values are."""


def is_smooth(function: cs.Function) -> bool:
    """Return whether a function's derivatives are finite wherever its values are.

    A square root counts if its value is only divided by: where its derivative is infinite, the quotient is, too.
    """
    operations = [function.instruction_id(k) for k in range(function.n_instructions())]
    return all(
        operation in _SMOOTH or (operation == cs.OP_SQRT and _is_only_divided_by(function, operations, k))
        for k, operation in enumerate(operations)
    )


def _is_only_divided_by(function: cs.Function, operations: list[int], k: int) -> bool:
    """Return whether all instructions that read the result of instruction k divide by it."""
    register = function.instruction_output(k)[0]
    for j, operation in enumerate(operations[k + 1 :], start=k + 1):
        read = [] if operation in (cs.OP_INPUT, cs.OP_CONST) else function.instruction_input(j)
        divides = operation == cs.OP_INV or (operation == cs.OP_DIV and read[0] != register)
        if register in read and not divides:
            return False
        if operation != cs.OP_OUTPUT and register in function.instruction_output(j):
            return True
    return True


def make_function(name: str, inputs: dict[str, cs.SX], columns: dict[str, cs.SX]) -> cs.Function:
    """Return a function whose outputs are dense columns."""
    values = [cs.densify(value) for value in columns.values()]
    return cs.Function(name, list(inputs.values()), values, list(inputs), list(columns), {"cse": True})


def make_derivatives(
    name: str, inputs: dict[str, cs.SX], matrices: dict[str, cs.SX], columns: dict[str, cs.SX] | None = None
) -> cs.Function:
    """Return a function whose outputs are sparse matrices (structural nonzeros only), then dense columns.

    Common subexpressions are not removed: the search for the last twentieth of them takes longer than all the rest of
    the lowering.
    """
    outs = {k: cs.sparsify(value) for k, value in matrices.items()}
    outs |= {k: cs.densify(value) for k, value in (columns or {}).items()}
    return cs.Function(name, list(inputs.values()), list(outs.values()), list(inputs), list(outs))
