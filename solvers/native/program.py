"""Programs: a compiled problem's modes and transitions as C sources, specialised to their sizes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files

import casadi as cs

from piaffe.ocp import LoweredMode, LoweredTransition
from piaffe.ocp.lanes import generate

from .kernel import link_kernel, mode_kernel

TEMPLATES = {name: files(__package__).joinpath("template", name).read_text(encoding="utf-8") for name in (
    "piaffe.h", "mode.inc", "rows.inc", "kkt.inc", "riccati.inc", "rollout.inc", "tiles.inc", "link.inc", "small.inc",
    "solver.c",
)}  # fmt: skip


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
    return Program(expressions, tuple(kernels), {**units.headers, **includes})
