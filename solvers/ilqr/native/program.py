"""Programs: a compiled problem's modes and transitions as C sources, specialised to their sizes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import casadi as cs

from piaffe.codegen import generate
from piaffe.codegen import simd as lanes
from piaffe.ocp import LoweredMode, LoweredTransition

from ... import constants
from .kernel import LINK_FUNCTIONS, MODE_FUNCTIONS, link_kernel, mode_kernel

TEMPLATES = {name: files(__package__).joinpath("template", name).read_text(encoding="utf-8") for name in (
    "piaffe.h", "parts.h",
    "solver.c", "manifold.inc", "barrier.inc", "trial.inc", "model.inc", "direction.inc", "search.inc", "outer.inc",
    "parts.inc",
    "mode.inc", "link.inc", "small.inc", "kkt.inc", "rows.inc", "riccati.inc", "tiles.inc", "rollout.inc",
)}  # fmt: skip
"""What is shared; the solver, one unit; a mode's or transition's unit."""

MAKERS = ("elimination.py", "nonzeros.py", "kernel.py", "library.py", "program.py", "tables.py")
_SOURCES = (  # read when they are imported: what they say later is not what made the texts
    *(files(__package__).joinpath(name).read_text(encoding="utf-8") for name in MAKERS),
    Path(lanes.__file__).read_text(encoding="utf-8"),
)


@dataclass(frozen=True)
class Program:
    """What is compiled into one library.

    Args:
        expressions: generated units (name, text): long, compiled lightly.
        kernels: the solver and its kernels (name, text): short, compiled hard.
        headers: file name → text.

    Modes have tables ``mode0_table``, ..., transitions ``link0_table``, ..., in the order given.
    """

    expressions: tuple[tuple[str, str], ...]
    kernels: tuple[tuple[str, str], ...]
    headers: Mapping[str, str]


def origin(modes: tuple[LoweredMode, ...], links: tuple[LoweredTransition, ...]) -> list[str]:
    """Return what :func:`program` makes its sources from: functions and sizes, and the modules that make them.

    To write the functions out as CasADi does takes a tenth of the time that it takes to lower them to C.
    """
    parts = [cs.CasadiMeta.version(), lanes.SIMD_H, constants_header(), *_SOURCES]
    parts += [part for entry in TEMPLATES.items() for part in entry]
    for mode in modes:
        spaces = [(block.ndx, block.quantity.kind) for block in mode.state.blocks]
        rows = [(name, len(rows)) for name, rows in mode.rows.items()]
        sizes = repr((spaces, mode.nu, mode.nz, mode.layout.size, rows, mode.model.definite_size(mode.key)))
        parts += ["mode", sizes, *_written(mode.functions, MODE_FUNCTIONS)]
    for link in links:
        definite = link.source.definite_size(link.key) if link.nz else 0
        sizes = repr((link.source.state.ndx, link.target.state.ndx, link.nz, link.layout.size, definite))
        parts += ["link", sizes, *_written(link.functions, LINK_FUNCTIONS)]
    return parts


def _written(functions: Mapping[str, cs.Function], names: tuple[str, ...]) -> list[str]:
    return [functions[name].serialize() for name in names]


def program(modes: tuple[LoweredMode, ...], links: tuple[LoweredTransition, ...]) -> Program:
    """Return the sources for modes and transitions."""
    functions: dict[str, cs.Function] = {}
    kernels = [("solver", TEMPLATES["solver.c"])]
    for number, mode in enumerate(modes):
        kernel = mode_kernel(number, mode)
        functions |= {f"mode{number}_f_{name}": f for name, f in kernel.functions.items()}
        kernels.append((f"mode{number}", kernel.text))
    for number, link in enumerate(links):
        kernel = link_kernel(number, link)
        functions |= {f"link{number}_f_{name}": f for name, f in kernel.functions.items()}
        kernels.append((f"link{number}", kernel.text))
    units = generate(functions)
    includes = {name: text for name, text in TEMPLATES.items() if name != "solver.c"}
    expressions = tuple((unit.name, unit.text) for unit in units.units)
    return Program(expressions, tuple(kernels), {**units.headers, **includes, "constants.h": constants_header()})


def constants_header() -> str:
    """Return the constants that both backends share, as C."""
    lines = [f"#define {name} {value!r}" for name, value in constants.table().items()]
    return "\n".join(["#ifndef PIAFFE_CONSTANTS_H", "#define PIAFFE_CONSTANTS_H", *lines, "#endif", ""])
