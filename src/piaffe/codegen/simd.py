"""Generate SIMD C code of CasADi functions: the numbers are vectors, and one call evaluates PIAFFE_W nodes.

The instructions of an SX function become straight-line C with a local constant per value. The code is divided into
*chunks*; each is a C function that is short enough for the compiler's register allocation. Values that are used in a
later chunk are stored in the work array ``w``, whose slots are reused. Chunks are distributed over translation units,
which compile in parallel. The code is the same for every width: a ``vd`` is ``PIAFFE_W`` doubles, and ``PIAFFE_W`` is a
macro on the compiler's command line.

The signature of each function NAME is::

    void NAME(const vd *const *arg, vd *const *res, vd *w);

Here ``arg[i][k]`` is nonzero k of input i, ``res[i][k]`` is nonzero k of output i, both column by column, and ``w`` has
``NAME_SZ_W`` elements. All arrays are aligned to the size of vd and do not overlap. A pointer may be null only if its
array has no nonzeros. The functions are reentrant.

Measured on the functions of a quadruped's contact mode (17 700 operations in ``stage_d``, 7 700 in ``implicit``; one
core with AVX-512, gcc 12, ``-O2 -march=native -ffp-contract=fast -fno-math-errno -fno-trapping-math``), microseconds
per node::

    doubles per vector                       8      4      1
    stage_d, sparsified                     0.62   0.94    3.6
    implicit                                0.21   0.37    1.5
    stage_d, dense (5 times as many stores)  3.1

clang also needs ``-mprefer-vector-width=512`` (1.14 µs without it, 0.62 with it). One core compiles the four functions
in 3 to 5 s. The time hardly depends on the size of the chunks (200 to 1500) or on the flags (-O1 to -O3). It depends on
the number of values that are needed later, and on the number of stored zeros.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from importlib.resources import files
from itertools import groupby
from math import isfinite, isnan
from typing import Self

import casadi as cs

from piaffe.errors import ModelError

SIMD_H = files(__package__).joinpath("simd.h").read_text(encoding="utf-8")

_CALLS = (
    "sqrt exp log log1p expm1 tan asin acos atan sinh cosh tanh asinh acosh atanh erf floor ceil pow fmod "
    "remainder atan2 hypot lt le eq ne not and or if_else_zero fmin fmax fabs copysign sign"
)
_TEMPLATES = {getattr(cs, f"OP_{name.upper()}"): f"lane_{name}({{}})" for name in _CALLS.split()} | {
    cs.OP_CONSTPOW: "lane_pow({})",
    cs.OP_ADD: "{0} + {1}",
    cs.OP_SUB: "{0} - {1}",
    cs.OP_MUL: "{0} * {1}",
    cs.OP_DIV: "{0} / {1}",
    cs.OP_NEG: "-{0}",
    cs.OP_SQ: "{0} * {0}",
    cs.OP_TWICE: "{0} + {0}",
    cs.OP_INV: "K(1.0) / {0}",
}
_OP_NAMES = {getattr(cs, name): name for name in dir(cs) if name.startswith("OP_")}


class UnsupportedOperationError(ModelError):
    """An operation of a function has no form in the generated code.

    Args:
        function: name of the function.
        operation: CasADi's name of the operation.
    """

    def __init__(self, function: str, operation: str) -> None:
        self.function, self.operation = function, operation
        super().__init__(
            f"function '{function}': an operation has no SIMD form - got {operation}, expected arithmetic, "
            "comparisons, selections or functions of the C library; write the expression without it"
        )

    def __reduce__(self) -> tuple[type[Self], tuple[str, str]]:
        return type(self), (self.function, self.operation)


def unsupported(function: cs.Function) -> str:
    """Return CasADi's name of an operation of a function that the generated code does not have; empty if it has all."""
    try:
        _single_assignment(function.name(), function)
    except UnsupportedOperationError as error:
        return error.operation
    return ""


@dataclass(frozen=True)
class Unit:
    """A translation unit.

    Args:
        name: an identifier, unique among the units.
        text: C source, which includes ``simd.h`` and ``functions.h``.
        instructions: number of instructions, a measure of its compile time.
    """

    name: str
    text: str
    instructions: int


@dataclass(frozen=True)
class Units:
    """Translation units of some functions, and their header.

    Args:
        units: the units, the longest first.
        header: text of ``functions.h``: prototypes and sizes.
        work: length of ``w`` per function, the value of the macro ``NAME_SZ_W``.
    """

    units: tuple[Unit, ...]
    header: str
    work: Mapping[str, int]

    @property
    def headers(self) -> dict[str, str]:
        """File name → text of the headers that the units include."""
        return {"simd.h": SIMD_H, "functions.h": self.header}


def generate(functions: Mapping[str, cs.Function], *, chunk: int = 500, unit: int = 6000) -> Units:
    """Generate the C code of functions.

    Args:
        functions: C name → function; MX functions are expanded.
        chunk: operations per C function.
        unit: approximate number of operations per translation unit; a chunk is not split.

    Returns:
        Translation units and header.

    Raises:
        UnsupportedOperationError: a function has an operation without a SIMD form.
        ModelError: it has free symbols.
    """
    if chunk < 1 or unit < 1:
        raise ValueError(f"generate: sizes must be positive - got chunk={chunk}, unit={unit}, expected 1 or more")
    header = ["#ifndef PIAFFE_FUNCTIONS_H", "#define PIAFFE_FUNCTIONS_H", "", '#include "simd.h"', ""]
    pieces: list[tuple[str, int]] = []
    work: dict[str, int] = {}
    for name, function in functions.items():
        chunks, work[name] = _chunks(_single_assignment(name, function), chunk)
        parts = [f"{name}__{i}" for i in range(len(chunks))]
        pieces += [(_definition(part, body), len(body)) for part, body in zip(parts, chunks, strict=True)]
        pieces.append((_definition(name, [f"{part}(arg, res, w);" for part in parts]), len(parts)))
        header.append(f"#define {name}_SZ_W {work[name]}")
        header += [f"void {part}{_SIGNATURE};" for part in (name, *parts)] + [""]
    header.append("#endif")
    return Units(_distributed(pieces, unit), "\n".join(header) + "\n", work)


def sparsified(function: cs.Function) -> cs.Function:
    """Return a function whose outputs contain only their structural nonzeros.

    Most entries of derivatives are zero; to store these zeros for every node takes longer than to compute the others.
    """
    inputs = [cs.SX.sym(name, function.sparsity_in(i)) for i, name in enumerate(function.name_in())]
    outputs = [cs.sparsify(output) for output in function.call(inputs)]
    return cs.Function(function.name(), inputs, outputs, function.name_in(), function.name_out(), {"cse": True})


_SIGNATURE = "(const vd *const *arg, vd *const *res, vd *w)"


@dataclass(frozen=True)
class _Step:
    """One operation; operands and results are values ``v{i}``, inputs ``a{i}[k]`` or literals."""

    results: tuple[str, ...]
    operands: tuple[str, ...]
    text: str


@dataclass(frozen=True)
class _Program:
    """A function in single-assignment form.

    Args:
        steps: its operations in the order of evaluation.
        stored: per value, the outputs that are equal to it.
        direct: outputs that are literals or inputs, as (output, nonzero, C expression).
    """

    steps: tuple[_Step, ...]
    stored: Mapping[str, Sequence[str]]
    direct: tuple[tuple[int, int, str], ...]


def _single_assignment(name: str, function: cs.Function) -> _Program:
    """Return a function in single-assignment form: its registers become values that are assigned once."""
    function = function if function.is_a("SXFunction") else function.expand()
    registers: dict[int, str] = {}
    steps: list[_Step] = []
    stored: dict[str, list[str]] = {}
    direct: list[tuple[int, int, str]] = []
    sincos: dict[str, dict[int, str]] = {}  # sine and cosine of one angle are one step

    def fresh() -> str:
        value = f"v{len(stored)}"
        stored[value] = []
        return value

    for k in range(function.n_instructions()):
        op, inputs, out = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == cs.OP_OUTPUT:
            value = registers[inputs[0]]
            if value in stored:
                stored[value].append(f"r{out[0]}[{out[1]}]")
            else:
                direct.append((out[0], out[1], value))
        elif op == cs.OP_CONST:
            registers[out[0]] = _literal(function.instruction_constant(k))
        elif op == cs.OP_INPUT:
            registers[out[0]] = f"a{inputs[0]}[{inputs[1]}]"
        elif op in (cs.OP_ASSIGN, cs.OP_LIFT):
            registers[out[0]] = registers[inputs[0]]
        elif op in (cs.OP_SIN, cs.OP_COS):
            angle = registers[inputs[0]]
            if angle not in sincos:
                sine, cosine = fresh(), fresh()
                sincos[angle] = {cs.OP_SIN: sine, cs.OP_COS: cosine}
                call = f"vd {sine}, {cosine}; lane_sincos({angle}, &{sine}, &{cosine});"
                steps.append(_Step((sine, cosine), (angle,), call))
            registers[out[0]] = sincos[angle][op]
        elif op in _TEMPLATES:
            operands = tuple(registers[i] for i in inputs)
            registers[out[0]] = value = fresh()
            template = _TEMPLATES[op]
            text = template.format(", ".join(operands)) if "{}" in template else template.format(*operands)
            steps.append(_Step((value,), operands, f"const vd {value} = {text};"))
        else:
            raise UnsupportedOperationError(name, _OP_NAMES.get(op, str(op)))
    return _Program(tuple(_depth_first(steps, stored)), stored, tuple(direct))


def _depth_first(steps: Sequence[_Step], stored: Mapping[str, Sequence[str]]) -> list[_Step]:
    """Return the steps that the outputs need, in depth-first order from the last output to the first.

    For the columns of a Jacobian this order goes from the leaves of the kinematic tree to its root. Fewer values have
    to be stored for later use than in CasADi's order: it needs a fifth less memory and a tenth less time.
    """
    maker = {value: i for i, step in enumerate(steps) for value in step.results}
    ordered: list[_Step] = []
    done = [False] * len(steps)
    for value in reversed([value for value, places in stored.items() if places]):
        stack = [maker[value]]
        while stack:
            i = stack[-1]
            waiting = [maker[o] for o in steps[i].operands if o in maker and not done[maker[o]]]
            if waiting:
                stack += reversed(waiting)
            else:
                stack.pop()
                if not done[i]:
                    done[i] = True
                    ordered.append(steps[i])
    return ordered


def _literal(value: float) -> str:
    if isfinite(value):
        return f"K({value!r})"
    return "K(NAN)" if isnan(value) else "K(INFINITY)" if value > 0 else "K(-INFINITY)"


def _chunks(program: _Program, size: int) -> tuple[list[list[str]], int]:
    """Return the statements of each chunk and the length of the work array."""
    last: dict[str, int] = {}  # per value, the step of its last use
    for i, step in enumerate(program.steps):
        last.update((operand, i) for operand in step.operands)
    slots: dict[str, str] = {}
    free: list[int] = []
    used = 0
    chunks: list[list[str]] = []
    for start in range(0, len(program.steps), size):
        end, lines, local = start + size, [], set[str]()
        for step in program.steps[start:end]:
            for operand in step.operands:
                if operand in slots and operand not in local:
                    lines.append(f"const vd {operand} = {slots[operand]};")
                    if last[operand] < end:  # no later chunk uses it: its slot is free
                        heappush(free, int(slots.pop(operand)[2:-1]))
                    local.add(operand)
            lines.append(step.text)
            for value in step.results:
                lines += [f"{place} = {value};" for place in program.stored[value]]
                if last.get(value, -1) >= end:
                    if not free:
                        heappush(free, used)
                        used += 1
                    slots[value] = f"w[{heappop(free)}]"
                    lines.append(f"{slots[value]} = {value};")
                    local.add(value)
        chunks.append(lines)
    fills = _fills(program.direct)
    chunks += [fills[i : i + size] for i in range(0, len(fills), size)]
    return chunks, used


def _fills(direct: Sequence[tuple[int, int, str]]) -> list[str]:
    """Return the statements that store literals and inputs; a run of equal values becomes a loop."""
    lines = []
    for (output, value), group in groupby(sorted(direct), key=lambda entry: (entry[0], entry[2])):
        nonzeros = [nonzero for _, nonzero, _ in group]
        if nonzeros[-1] - nonzeros[0] + 1 == len(nonzeros) > 3:
            lines.append(f"lane_fill(r{output} + {nonzeros[0]}, {len(nonzeros)}, {value});")
        else:
            lines += [f"r{output}[{nonzero}] = {value};" for nonzero in nonzeros]
    return lines


def _definition(name: str, lines: Sequence[str]) -> str:
    """Return a C function; it has local pointers to the inputs and outputs that its statements use."""
    text = "\n".join(f"    {line}" for line in lines)
    pointers = [
        f"    {kind}{i} = {source}[{i}];"
        for letter, kind, source in (("a", "const vd *restrict a", "arg"), ("r", "vd *restrict r", "res"))
        for i in sorted({int(i) for i in re.findall(rf"\b{letter}(\d+)\b", text)})
    ]
    body = "\n".join(["    (void)arg; (void)res; (void)w;", *pointers, text])
    return f"void {name}{_SIGNATURE.replace('*w', '*restrict w')}\n{{\n{body}\n}}\n"


def _distributed(pieces: Sequence[tuple[str, int]], size: int) -> tuple[Unit, ...]:
    """Return units of about the given size, the longest first."""
    units: list[tuple[list[str], int]] = []
    for text, length in pieces:
        if not units or units[-1][1] + length > size:
            units.append(([], 0))
        texts, total = units[-1]
        units[-1] = ([*texts, text], total + length)
    ordered = sorted(units, key=lambda u: -u[1])
    include = '#include "functions.h"\n\n'
    return tuple(Unit(f"functions{i}", include + "\n".join(texts), n) for i, (texts, n) in enumerate(ordered))
