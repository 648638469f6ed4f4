"""Programs: a compiled problem's modes and transitions as C sources, specialised to their sizes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files

import casadi as cs

from piaffe.ocp import LoweredMode, LoweredTransition
from piaffe.ocp.lanes import generate

from .tables import TABLE, defines, dynamics_rows

TEMPLATES = {name: files(__package__).joinpath("template", name).read_text(encoding="utf-8") for name in (
    "piaffe.h", "mode.inc", "riccati.inc", "rollout.inc", "tiles.inc", "link.inc", "small.inc", "solver.c"
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
        own = mode_functions(mode)
        functions |= {f"mode{number}_f_{name}": f for name, f in own.items()}
        kernels.append((f"mode{number}", _mode_source(number, mode, own)))
    for number, link in enumerate(links):
        own = link_functions(link)
        functions |= {f"link{number}_f_{name}": f for name, f in own.items()}
        kernels.append((f"link{number}", _link_source(number, link, own)))
    units = generate(functions)
    includes = {name: text for name, text in TEMPLATES.items() if name != "solver.c"}
    expressions = tuple((unit.name, unit.text) for unit in units.units)
    return Program(expressions, tuple(kernels), {**units.headers, **includes})


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


def _elimination(K: cs.Sparsity, first: int) -> tuple[list[int], list[list[int]], list[list[int]]]:
    """Return an order of elimination, and per permuted row the entries of L and U with the fill it leaves.

    The ``first`` unknowns, a definite block, go in the order of least degree on the pattern of K + Kᵀ; the others
    follow as they come.
    """
    n = K.size1()
    links: dict[int, set[int]] = {i: set() for i in range(n)}
    for r, c in zip(K.row(), K.get_col(), strict=True):
        if r != c:
            links[r].add(c)
            links[c].add(r)
    pattern = {i: set(neighbours) for i, neighbours in links.items()}
    order: list[int] = []
    rest = set(range(n))
    while rest:
        candidates = [i for i in rest if i < first] or [min(rest)]
        pick = min(candidates, key=lambda i: (len(links[i]), i))
        rest.remove(pick)
        for i in links[pick]:
            links[i] |= links[pick] - {i}
            links[i].discard(pick)
            pattern[i] |= links[pick] - {i}
        order.append(pick)
    at = {unknown: place for place, unknown in enumerate(order)}
    rows = [sorted(at[j] for j in pattern[i]) for i in order]
    return (
        order,
        [[k for k in row if k < i] for i, row in enumerate(rows)],
        [[k for k in row if k > i] for i, row in enumerate(rows)],
    )


def _elimination_tables(K: cs.Sparsity, first: int) -> list[str]:
    if K.size1() == 0:
        return []
    order, lower, upper = _elimination(K, first)
    lines = [f"static const int order[] = {{{', '.join(map(str, order))}}};"]
    for name, lists in (("lower", lower), ("upper", upper)):
        ends = [0]
        for entries in lists:
            ends.append(ends[-1] + len(entries))
        flat = [k for entries in lists for k in entries]
        lines.append(f"static const int {name}[] = {{{', '.join(map(str, ends))}}};")
        lines.append(f"static const int {name}_at[] = {{{', '.join(map(str, flat)) or '0'}}};")
    return lines


def _place(K: cs.Sparsity, first: int) -> list[int]:
    """Return where each unknown went."""
    order = _elimination(K, first)[0] if K.size1() else []
    place = [0] * len(order)
    for at, unknown in enumerate(order):
        place[unknown] = at
    return place


def _table(
    name: str, sparsity: cs.Sparsity, place_rows: list[int] | None = None, place_cols: list[int] | None = None
) -> list[str]:
    rows, cols = list(sparsity.row()), list(sparsity.get_col())
    rows = [place_rows[r] for r in rows] if place_rows is not None else rows
    cols = [place_cols[c] for c in cols] if place_cols is not None else cols
    return [
        f"#define NNZ_{name} {len(rows)}",
        f"{TABLE} {name}_row[] = {{{', '.join(map(str, rows)) or '0'}}};",
        f"{TABLE} {name}_col[] = {{{', '.join(map(str, cols)) or '0'}}};",
    ]


def _mode_source(number: int, mode: LoweredMode, own: Mapping[str, cs.Function]) -> str:
    rows = {name: len(r) for name, r in mode.rows.items()}
    state = mode.state
    lines = defines(
        ID=number, NX=state.nx, NDX=state.ndx, NU=mode.nu, NZ=mode.nz, NP=mode.layout.size,
        NR=rows["stage_residual"], NG=rows["stage_g"], NH=rows["stage_h"], MR=rows["terminal_residual"],
        MG=rows["terminal_g"], MH=rows["terminal_h"], NUM_PARTS=len(state.blocks),
    )  # fmt: skip
    lines.append('#include "functions.h"')
    K, lq = own["implicit"].sparsity_out(0), own["lq"]
    first = mode.model.definite_size(mode.key)
    place = _place(K, first)
    in_v = [*range(state.ndx + mode.nu), *(state.ndx + mode.nu + k for k in place)]
    lines += _elimination_tables(K, first) + _table("K", K, place, place)
    lines += _table("r_w", lq.sparsity_out(0), place) + _table("d_w", lq.sparsity_out(1))
    lines += _table("d_z", lq.sparsity_out(2), None, place) + _table("H", lq.sparsity_out(4), in_v, in_v)
    lines += _table("H_end", own["terminal_lq"].sparsity_out(1))
    lines += dynamics_rows(lq.sparsity_out(1), lq.sparsity_out(2))
    lines.append(f"static const int part_size[] = {{{', '.join(str(b.ndx) for b in state.blocks)}}};")
    rotations = (str(int(b.quantity.kind == "rotation")) for b in state.blocks)
    lines.append(f"static const int part_is_rotation[] = {{{', '.join(rotations)}}};")
    return "\n".join([*lines, '#include "mode.inc"', ""])


def _link_source(number: int, link: LoweredTransition, own: Mapping[str, cs.Function]) -> str:
    source, target = link.source.state, link.target.state
    lines = defines(
        ID=number, NX=source.nx, NDX=source.ndx, NXN=target.nx, NDXN=target.ndx, NZ=link.nz, NP=link.layout.size
    )
    lines.append('#include "functions.h"')
    K, reset_d = own["implicit"].sparsity_out(0), own["reset_d"]
    first = link.source.definite_size(link.key) if link.nz else 0
    place = _place(K, first)
    lines += (
        _elimination_tables(K, first) + _table("K", K, place, place) + _table("r_x", reset_d.sparsity_out(0), place)
    )
    lines += _table("d_x", reset_d.sparsity_out(1)) + _table("d_z", reset_d.sparsity_out(2), None, place)
    return "\n".join([*lines, '#include "link.inc"', ""])
