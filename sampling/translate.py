"""CasADi functions on arrays of NumPy or JAX: the instruction list, with each operation on all samples at once.

No maintained library does this: see the decision on scoring in docs/adr. All operations of ``piaffe.codegen.simd`` are
supported here, too. Comparisons give 0.0 or 1.0, as in CasADi.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import ModuleType
from typing import Any

import casadi as cs
import numpy as np

from piaffe.errors import ModelError, SamplingError

Operation = Callable[..., Any]


@dataclass(frozen=True)
class _Step:
    """One operation: apply it to the operands, store the result, and delete values that are not used any more."""

    apply: Operation
    operands: tuple[int, ...]
    result: int
    dropped: tuple[int, ...]


@dataclass(frozen=True)
class Translated:
    """The instructions of a CasADi function, for arrays.

    Args:
        name: name of the function.
        num_in: number of inputs.
        sizes: number of rows of each output.
        inputs: value index → (input, component), for the components that are used.
        constants: value index → number.
        steps: operations in order.
        outputs: for each output, the value index of each row, -1 for a structural zero.
        count: number of values.
    """

    name: str
    num_in: int
    sizes: tuple[int, ...]
    inputs: Mapping[int, tuple[int, int]]
    constants: Mapping[int, float]
    steps: tuple[_Step, ...]
    outputs: tuple[tuple[int, ...], ...]
    count: int

    def columns(self, *arguments: Sequence[Any]) -> list[list[Any]]:
        """Return the rows of each output, each an array or a number.

        Args:
            *arguments: components of each input, arrays that broadcast against each other.
        """
        values: list[Any] = [None] * self.count
        for index, (i, k) in self.inputs.items():
            values[index] = arguments[i][k]
        for index, number in self.constants.items():
            values[index] = number
        for step in self.steps:
            values[step.result] = step.apply(*(values[i] for i in step.operands))
            for i in step.dropped:
                values[i] = None
        return [[0.0 if i < 0 else values[i] for i in rows] for rows in self.outputs]


def translate(function: cs.Function) -> Callable[..., tuple[Any, ...]]:
    """Return a CasADi function as a function of JAX arrays, for use within ``jit``, ``vmap`` and ``grad``.

    Args:
        function: a function of columns with outputs that are columns; an MX function is expanded.

    Returns:
        A function of one array (..., size) per input, with leading axes that broadcast. It returns a tuple of arrays
        (..., rows), in the precision of its arguments: double precision must be enabled in JAX.

    Raises:
        SamplingError: JAX is not installed.
        ModelError: an operation has no form on arrays.
    """
    jax = import_jax()
    jnp = jax.numpy
    program = instructions(function, jnp, jax.scipy.special.erf)

    def translated(*arguments: Any) -> tuple[Any, ...]:
        parts = [jnp.asarray(argument) for argument in arguments]
        lead = jnp.broadcast_shapes(*(part.shape[:-1] for part in parts))
        dtype = jnp.result_type(*parts)
        results = program.columns(*([part[..., k] for k in range(part.shape[-1])] for part in parts))
        return tuple(
            jnp.stack([jnp.broadcast_to(jnp.asarray(row, dtype), lead) for row in rows], axis=-1)
            if rows
            else jnp.zeros((*lead, 0), dtype)
            for rows in results
        )

    translated.__name__ = function.name()
    return translated


def import_jax() -> Any:
    """Return the module ``jax`` with the submodules that are used.

    Raises:
        SamplingError: JAX is not installed.
    """
    try:
        import jax
        import jax.numpy
        import jax.scipy.special
    except ImportError as error:
        raise SamplingError(
            f"sampling: JAX cannot be imported - got {error}, expected the packages of sampling on JAX; "
            "pip install 'piaffe[sampling]', or choose engine=\"native\""
        ) from error
    return jax


@lru_cache(maxsize=128)
def instructions(function: cs.Function, xp: ModuleType, erf: Operation) -> Translated:
    """Return a function's instructions for an array module.

    Args:
        function: a function of columns; an MX function is expanded.
        xp: ``numpy`` or ``jax.numpy``.
        erf: the error function for these arrays.

    Raises:
        ModelError: an operation has no form on arrays.
    """
    table = _operations(xp, erf)
    name = function.name()
    function = function if function.is_a("SXFunction") else function.expand()
    registers: dict[int, int] = {}
    inputs: dict[int, tuple[int, int]] = {}
    constants: dict[int, float] = {}
    operations: list[tuple[Operation, tuple[int, ...], int]] = []
    rows = [dict(enumerate(function.sparsity_out(i).row())) for i in range(function.n_out())]
    outputs = [[-1] * function.size1_out(i) for i in range(function.n_out())]
    count = 0
    for k in range(function.n_instructions()):
        op, read, wrote = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == cs.OP_OUTPUT:
            outputs[wrote[0]][rows[wrote[0]][wrote[1]]] = registers[read[0]]
            continue
        if op in (cs.OP_ASSIGN, cs.OP_LIFT):
            registers[wrote[0]] = registers[read[0]]
            continue
        if op == cs.OP_INPUT:
            inputs[count] = (read[0], read[1])
        elif op == cs.OP_CONST:
            constants[count] = function.instruction_constant(k)
        elif op in table:
            operations.append((table[op], tuple(registers[i] for i in read), count))
        else:
            raise ModelError(
                f"function '{name}': an operation has no form on arrays - got {_OP_NAMES.get(op, op)}, expected "
                "arithmetic, comparisons, selections or functions of the C library; write the expression without it"
            )
        registers[wrote[0]] = count
        count += 1
    kept = {i for output in outputs for i in output}
    last = {operand: step for step, (_, operands, _) in enumerate(operations) for operand in operands}
    dropped: dict[int, list[int]] = {}
    for operand, at in last.items():
        if operand not in kept:
            dropped.setdefault(at, []).append(operand)
    steps = tuple(_Step(*operation, tuple(dropped.get(i, ()))) for i, operation in enumerate(operations))
    return Translated(
        name, function.n_in(), tuple(len(o) for o in outputs), inputs, constants, steps,
        tuple(tuple(o) for o in outputs), count,
    )  # fmt: skip


_OP_NAMES = {getattr(cs, name): name for name in dir(cs) if name.startswith("OP_")}
_SAME = "sqrt exp log log1p expm1 sin cos tan sinh cosh tanh floor ceil fmod hypot fmin fmax fabs copysign sign"
_RENAMED = {
    "asin": "arcsin", "acos": "arccos", "atan": "arctan", "asinh": "arcsinh", "acosh": "arccosh", "atanh": "arctanh",
    "atan2": "arctan2", "pow": "power", "constpow": "power",
}  # fmt: skip


@lru_cache(maxsize=4)
def _operations(xp: Any, erf: Operation) -> Mapping[int, Operation]:
    """Return the operations of an array module by CasADi's operation number."""

    def truth(condition: Any) -> Any:
        return xp.where(condition, 1.0, 0.0)

    def remainder(a: Any, b: Any) -> Any:
        """Return a − n b without rounding errors, for the integer n nearest to a / b; of two nearest, the even one."""
        b = xp.fabs(b)
        r = xp.fmod(xp.fabs(a), b + b)
        near = xp.where(r + r > b, r - b, r)
        return xp.copysign(1.0, a) * xp.where((r + r > b) & (near + near >= b), near - b, near)

    table: dict[str, Operation] = {name: getattr(xp, name) for name in _SAME.split()}
    table |= {name: getattr(xp, other) for name, other in _RENAMED.items()}
    table |= {
        "add": lambda a, b: a + b,
        "sub": lambda a, b: a - b,
        "mul": lambda a, b: a * b,
        "div": lambda a, b: a / b,
        "neg": lambda a: -a,
        "sq": lambda a: a * a,
        "twice": lambda a: a + a,
        "inv": lambda a: 1.0 / a,
        "erf": erf,
        "remainder": remainder,
        "lt": lambda a, b: truth(a < b),
        "le": lambda a, b: truth(a <= b),
        "eq": lambda a, b: truth(a == b),
        "ne": lambda a, b: truth(a != b),
        "not": lambda a: truth(a == 0),
        "and": lambda a, b: truth((a != 0) & (b != 0)),
        "or": lambda a, b: truth((a != 0) | (b != 0)),
        "if_else_zero": lambda a, b: xp.where(a != 0, b, 0.0),
    }
    return {getattr(cs, f"OP_{name.upper()}"): operation for name, operation in table.items()}


NUMPY_ERF: Operation = np.vectorize(math.erf, otypes=[float])
"""The error function on NumPy arrays, which NumPy lacks."""
