"""Programs: a compiled problem's modes and transitions as C sources, specialised to their sizes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files

import casadi as cs

from piaffe.ocp import CompiledProblem, LoweredMode, LoweredTransition
from piaffe.ocp.lanes import generate

TEMPLATES = {name: files(__package__).joinpath("template", name).read_text(encoding="utf-8") for name in (
    "piaffe.h", "mode.inc", "link.inc", "small.inc", "solver.c"
)}  # fmt: skip


@dataclass(frozen=True)
class Program:
    """What is compiled into one library.

    Args:
        expressions: generated units (name, text): long, compiled lightly.
        kernels: the solver and its kernels (name, text): short, compiled hard.
        headers: file name → text.
        modes: the modes, in the order of their tables ``mode0_table``, ...
        links: the transitions, in the order of ``link0_table``, ...
    """

    expressions: tuple[tuple[str, str], ...]
    kernels: tuple[tuple[str, str], ...]
    headers: Mapping[str, str]
    modes: tuple[LoweredMode, ...]
    links: tuple[LoweredTransition, ...]


def program(problem: CompiledProblem) -> Program:
    """Return the sources for a compiled problem's modes and transitions."""
    modes = tuple(dict.fromkeys(phase.mode for phase in problem.phases))
    links = tuple(dict.fromkeys(phase.transition for phase in problem.phases if phase.transition is not None))
    functions: dict[str, cs.Function] = {}
    kernels = [("solver", TEMPLATES["solver.c"])]
    for number, mode in enumerate(modes):
        own = mode_functions(mode)
        functions |= {f"mode{number}_f_{name}": f for name, f in own.items()}
        kernels.append((f"mode{number}", _mode_source(number, mode, own)))
    for number, link in enumerate(links):
        own = link_functions(link)
        functions |= {f"link{number}_f_{name}": f for name, f in own.items()}
        kernels.append((f"link{number}", _link_source(number, link, own)))
    units = generate(functions)
    includes = {name: text for name, text in TEMPLATES.items() if name != "solver.c"}
    return Program(
        tuple((unit.name, unit.text) for unit in units.units),
        tuple(kernels),
        {**units.headers, **includes},
        modes,
        links,
    )


def _make(name: str, inputs: list[cs.SX], outputs: list[cs.SX]) -> cs.Function:
    return cs.Function(name, inputs, outputs, {"cse": True})


def mode_functions(mode: LoweredMode) -> dict[str, cs.Function]:
    """Return a mode's functions with sparse outputs, and least squares contracted to gradient and Hessian.

    ``lq`` takes, beside x, u, z, p and the next state, a slope and a curvature per row (residuals, inequalities,
    equalities) and returns r_w, d_w, d_z, Jᵀ slope and the upper triangle of Jᵀ diag(curvature) J over (w, z).
    """
    f = mode.functions
    x, u, z, p = (cs.SX.sym(n, f["stage"].size1_in(i)) for i, n in enumerate("xuzp"))
    xn = cs.SX.sym("xn", x.numel())
    K, r0 = f["implicit"](x, u, p)
    r_w, d_w, *by_w, d_z, res_z, g_z, h_z = (cs.sparsify(j) for j in f["stage_d"](x, u, z, p, xn))
    J = cs.horzcat(cs.vertcat(*by_w), cs.vertcat(res_z, g_z, h_z))
    slope, curvature, gradient, hessian = _contracted(J)
    J_end = cs.vertcat(*(cs.sparsify(j) for j in f["terminal_d"](x, p)))
    end_slope, end_curvature, end_gradient, end_hessian = _contracted(J_end)
    return {
        "implicit": _make("implicit", [x, u, p], [cs.sparsify(K), cs.densify(r0)]),
        "stage": f["stage"],
        "lq": _make("lq", [x, u, z, p, xn, slope, curvature], [r_w, d_w, d_z, gradient, hessian]),
        "terminal": f["terminal"],
        "terminal_lq": _make("terminal_lq", [x, p, end_slope, end_curvature], [end_gradient, end_hessian]),
    }


def link_functions(link: LoweredTransition) -> dict[str, cs.Function]:
    """Return a transition's functions with sparse outputs."""
    f = link.functions
    x, z, p = (cs.SX.sym(n, f["reset"].size1_in(i)) for i, n in enumerate("xzp"))
    xn = cs.SX.sym("xn", link.target.state.nx)
    K, r0 = f["implicit"](x, p)
    return {
        "implicit": _make("implicit", [x, p], [cs.sparsify(K), cs.densify(r0)]),
        "reset": f["reset"],
        "reset_d": _make("reset_d", [x, z, p, xn], [cs.sparsify(j) for j in f["reset_d"](x, z, p, xn)]),
    }


def _contracted(J: cs.SX) -> tuple[cs.SX, cs.SX, cs.SX, cs.SX]:
    slope, curvature = cs.SX.sym("slope", J.size1()), cs.SX.sym("curvature", J.size1())
    hessian = cs.triu(cs.mtimes(J.T, cs.mtimes(cs.diag(curvature), J)))
    return slope, curvature, cs.densify(cs.mtimes(J.T, slope)), hessian


def _table(name: str, sparsity: cs.Sparsity) -> list[str]:
    rows, cols = sparsity.row(), sparsity.get_col()
    return [
        f"#define NNZ_{name} {len(rows)}",
        f"static const int {name}_row[] = {{{', '.join(map(str, rows)) or '0'}}};",
        f"static const int {name}_col[] = {{{', '.join(map(str, cols)) or '0'}}};",
    ]


def _defines(**values: int) -> list[str]:
    return [f"#define {name} {value}" for name, value in values.items()]


def _mode_source(number: int, mode: LoweredMode, own: Mapping[str, cs.Function]) -> str:
    rows = {name: len(r) for name, r in mode.rows.items()}
    state = mode.state
    lines = _defines(
        ID=number, NX=state.nx, NDX=state.ndx, NU=mode.nu, NZ=mode.nz, NP=mode.layout.size,
        NR=rows["stage_residual"], NG=rows["stage_g"], NH=rows["stage_h"], MR=rows["terminal_residual"],
        MG=rows["terminal_g"], MH=rows["terminal_h"], NUM_PARTS=len(state.blocks),
    )  # fmt: skip
    lines.append('#include "functions.h"')
    lines += _table("K", own["implicit"].sparsity_out(0))
    for i, name in enumerate(("r_w", "d_w", "d_z")):
        lines += _table(name, own["lq"].sparsity_out(i))
    lines += _table("H", own["lq"].sparsity_out(4)) + _table("H_end", own["terminal_lq"].sparsity_out(1))
    lines.append(f"static const int part_size[] = {{{', '.join(str(b.ndx) for b in state.blocks)}}};")
    rotations = (str(int(b.quantity.kind == "rotation")) for b in state.blocks)
    lines.append(f"static const int part_is_rotation[] = {{{', '.join(rotations)}}};")
    return "\n".join([*lines, '#include "mode.inc"', ""])


def _link_source(number: int, link: LoweredTransition, own: Mapping[str, cs.Function]) -> str:
    source, target = link.source.state, link.target.state
    lines = _defines(
        ID=number, NX=source.nx, NDX=source.ndx, NXN=target.nx, NDXN=target.ndx, NZ=link.nz, NP=link.layout.size
    )
    lines.append('#include "functions.h"')
    lines += _table("K", own["implicit"].sparsity_out(0))
    for i, name in enumerate(("r_x", "d_x", "d_z")):
        lines += _table(name, own["reset_d"].sparsity_out(i))
    return "\n".join([*lines, '#include "link.inc"', ""])
