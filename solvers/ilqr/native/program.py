"""Programs: the C sources of the solver for the modes and transitions of a compiled problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import casadi as cs

from piaffe.codegen import generate, simd
from piaffe.ocp import SAME_TIME, LoweredMode, LoweredTransition

from ... import constants
from .kernel import MODE_FUNCTIONS, TRANSITION_FUNCTIONS, mode_kernel, transition_kernel

TEMPLATES = {name: files(__package__).joinpath("template", name).read_text(encoding="utf-8") for name in (
    "piaffe.h", "parts.h",
    "solver.c", "manifold.inc", "barrier.inc", "trial.inc", "model.inc", "direction.inc", "clock.inc", "hybrid.inc",
    "search.inc", "outer.inc", "parts.inc",
    "mode.inc", "transition.inc", "small.inc", "kkt.inc", "rows.inc", "riccati.inc", "tiles.inc", "finish.inc",
    "rollout.inc",
)}  # fmt: skip
"""Shared headers; files of the solver's unit; files of the units of modes and transitions."""

MAKERS = ("elimination.py", "nonzeros.py", "kernel.py", "library.py", "program.py", "tables.py")
_SOURCES = (  # read at import, because a later change of a file does not change the imported code
    *(files(__package__).joinpath(name).read_text(encoding="utf-8") for name in MAKERS),
    Path(simd.__file__).read_text(encoding="utf-8"),
)


@dataclass(frozen=True)
class Program:
    """The sources of one library.

    Args:
        expressions: generated units (name, text): long, compiled with low optimisation.
        kernels: the solver and its kernels (name, text): short, compiled with high optimisation.
        headers: file name → text.

    Modes have tables ``mode0_table``, ..., transitions ``transition0_table``, ..., in the given order.
    """

    expressions: tuple[tuple[str, str], ...]
    kernels: tuple[tuple[str, str], ...]
    headers: Mapping[str, str]


def source_parts(modes: tuple[LoweredMode, ...], transitions: tuple[LoweredTransition, ...]) -> list[str]:
    """Return texts that determine the sources of :func:`program`: functions, sizes, and the modules that make them.

    To serialise the functions takes a tenth of the time that it takes to generate their C code.
    """
    parts = [cs.CasadiMeta.version(), simd.SIMD_H, constants_header(), sizes_header(modes), *_SOURCES]
    parts += [part for entry in TEMPLATES.items() for part in entry]
    for mode in modes:
        spaces = [(block.ndx, block.quantity.kind) for block in mode.state.blocks]
        rows = [(name, len(rows)) for name, rows in mode.rows.items()]
        sizes = repr((spaces, mode.nu, mode.nz, mode.layout.size, rows, mode.model.definite_size(mode.key)))
        sizes += repr((mode.state_sizes.tolist(), mode.control_sizes.tolist()))
        parts += ["mode", sizes, *_serialized(mode.functions, MODE_FUNCTIONS)]
    for transition in transitions:
        source, target = transition.source, transition.target
        definite = source.definite_size(transition.key) if transition.nz else 0
        counts = [(name, len(rows)) for name, rows in transition.rows.items()]
        sizes = repr((source.state.ndx, target.state.ndx, transition.nz, transition.layout.size, counts, definite))
        parts += ["transition", sizes, *_serialized(transition.functions, TRANSITION_FUNCTIONS)]
    return parts


def _serialized(functions: Mapping[str, cs.Function], names: tuple[str, ...]) -> list[str]:
    return [functions[name].serialize() if name in functions else "none" for name in names]


def program(modes: tuple[LoweredMode, ...], transitions: tuple[LoweredTransition, ...]) -> Program:
    """Return the sources for modes and transitions."""
    functions: dict[str, cs.Function] = {}
    kernels = [("solver", TEMPLATES["solver.c"])]
    for number, mode in enumerate(modes):
        kernel = mode_kernel(number, mode)
        functions |= {f"mode{number}_f_{name}": f for name, f in kernel.functions.items()}
        kernels.append((f"mode{number}", kernel.text))
    for number, transition in enumerate(transitions):
        kernel = transition_kernel(number, transition)
        functions |= {f"transition{number}_f_{name}": f for name, f in kernel.functions.items()}
        kernels.append((f"transition{number}", kernel.text))
    units = generate(functions)
    includes = {name: text for name, text in TEMPLATES.items() if name != "solver.c"}
    expressions = tuple((unit.name, unit.text) for unit in units.units)
    headers = {"constants.h": constants_header(), "sizes.h": sizes_header(modes)}
    return Program(expressions, tuple(kernels), {**units.headers, **includes, **headers})


def sizes_header(modes: tuple[LoweredMode, ...]) -> str:
    """Return the size of the largest state or control of some modes, as C."""
    most = max(max(mode.state.nx, mode.state.ndx, mode.nu) for mode in modes)
    lines = ["#ifndef PIAFFE_SIZES_H", "#define PIAFFE_SIZES_H", f"#define MOST_NUMBERS {most}", "#endif", ""]
    return "\n".join(lines)


def constants_header() -> str:
    """Return the constants that both backends share, and from which difference on two times differ, as C."""
    shared = {**constants.table(), "SAME_TIME": SAME_TIME}
    lines = [f"#define {name} {value!r}" for name, value in shared.items()]
    return "\n".join(["#ifndef PIAFFE_CONSTANTS_H", "#define PIAFFE_CONSTANTS_H", *lines, "#endif", ""])
