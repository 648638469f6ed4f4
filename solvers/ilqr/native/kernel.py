"""Kernels: the C code of one mode or transition, made of generated functions and a template with their sizes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as cs

from piaffe.ocp import LoweredMode, LoweredTransition

from .elimination import Elimination, eliminate
from .nonzeros import Nonzeros
from .tables import defines, dynamics_rows, finish_entries, natural_sizes, table

MODE_FUNCTIONS = ("implicit", "stage", "stage_d", "split_d", "terminal", "terminal_d")
TRANSITION_FUNCTIONS = ("implicit", "reset", "reset_d", "rows", "rows_d")
"""The functions of a mode and of a transition that a kernel contains; a mode's step need not be split."""
WHOLE_VECTORS = 8
"""The number of outputs of a function is rounded up to a multiple of this."""


@dataclass(frozen=True)
class Kernel:
    """The C code of one mode or transition.

    Args:
        functions: the functions that the template calls by ``GENERATED(name)``.
        text: sizes and tables, then the template.
    """

    functions: Mapping[str, cs.Function]
    text: str


_LINE = 8
"""Doubles in a cache line."""


class _Outputs:
    """Outputs of a function in one array, with the C constants of their positions in it."""

    def __init__(self) -> None:
        self.values: list[cs.SX] = []
        self.lines: list[str] = []
        self.size = 0
        self.written: dict[str, set[int]] = {"D": set(), "H": set()}  # entries of a node's matrices that may be nonzero

    def add(self, name: str, values: cs.SX, lines: Iterable[str] = ()) -> None:
        self.lines += [f"#define AT_{name} {self.size}", *lines]
        self.values.append(cs.vec(cs.densify(values)))
        self.size += values.numel()

    def tables(self) -> list[str]:
        size = max(-(-self.size // WHOLE_VECTORS) * WHOLE_VECTORS, WHOLE_VECTORS)
        ahead = {name: sorted({at // _LINE * _LINE for at in places}) for name, places in self.written.items()}
        return [
            *self.lines, f"#define NUM_OUT {size}", *(f"#define NUM_AHEAD_{k} {len(v)}" for k, v in ahead.items()),
            table("ahead", [*ahead["D"], *ahead["H"]]),
        ]  # fmt: skip

    def function(self, name: str, inputs: list[cs.SX]) -> cs.Function:
        return _make(name, inputs, [cs.vertcat(*self.values)])


def mode_kernel(number: int, mode: LoweredMode) -> Kernel:
    """Return the kernel of a mode.

    The inputs of its ``lq`` are x, u, z, p, the next state, and a slope and a curvature per row (residuals,
    inequalities, equalities). Its outputs contain the gradient Jᵀ slope and the upper triangle of the Hessian
    Jᵀ diag(curvature) J over (w, z).
    """
    f, state = mode.functions, mode.state
    x, u, z, p = (cs.SX.sym(n, f["stage"].size1_in(i)) for i, n in enumerate("xuzp"))
    xn = cs.SX.sym("xn", x.numel())
    nw = state.ndx + mode.nu
    rows = {name: len(r) for name, r in mode.rows.items()}
    K, r0 = f["implicit"](x, u, p)
    implicit = _Implicit(K, r0, mode.model.definite_size(mode.key))
    r_w, d_w, *by_w, d_z, res_z, g_z, h_z = f["stage_d"](x, u, z, p, xn)
    beyond = cs.SX(state.ndx, state.ndx)
    if "split_d" in f:
        d_w, d_z, finish = f["split_d"](x, u, z, p, xn)
        beyond = cs.sparsify(finish - cs.SX.eye(state.ndx))
    J = cs.horzcat(cs.vertcat(*by_w), cs.vertcat(res_z, g_z, h_z))
    slope, curvature, gradient, hessian = _contracted(J)
    out = _Outputs()
    _sensitivity(out, implicit.elimination, r_w, d_w, d_z)
    out.add("finish", Nonzeros.of(beyond.T).values, finish_entries(beyond.sparsity()))
    _model(out, implicit.elimination, gradient, hessian, nw)
    end_slope, end_curvature, end_gradient, end_hessian = _contracted(cs.SX(cs.vertcat(*f["terminal_d"](x, p))))
    end = Nonzeros.of(end_hessian)
    functions = {
        "implicit": implicit.function([x, u, p]),
        "stage": f["stage"],
        "lq": out.function("lq", [x, u, z, p, xn, slope, curvature]),
        "terminal": f["terminal"],
        "terminal_lq": _make(
            "terminal_lq", [x, p, end_slope, end_curvature], [cs.densify(end_gradient), end.values]
        ),
    }  # fmt: skip
    lines = defines(
        ID=number, NX=state.nx, NDX=state.ndx, NU=mode.nu, NZ=mode.nz, NP=mode.layout.size,
        NR=rows["stage_residual"], NG=rows["stage_g"], NH=rows["stage_h"], MR=rows["terminal_residual"],
        MG=rows["terminal_g"], MH=rows["terminal_h"], NUM_PARTS=len(state.blocks),
    )  # fmt: skip
    lines += ['#include "functions.h"', *implicit.elimination.tables(), *out.tables(), *end.tables("H_end")]
    lines += dynamics_rows(cs.sparsify(d_w).sparsity(), cs.sparsify(d_z).sparsity())
    lines.append(table("part_size", [b.ndx for b in state.blocks]))
    lines.append(table("part_is_rotation", [int(b.quantity.kind == "rotation") for b in state.blocks]))
    lines += natural_sizes(mode.state_sizes, mode.control_sizes)
    return Kernel(functions, "\n".join([*lines, '#include "mode.inc"', ""]))


def transition_kernel(number: int, transition: LoweredTransition) -> Kernel:
    """Return the kernel of a transition.

    The outputs of its ``reset`` are the next state and the transition's rows, those of its ``reset_d`` the derivatives
    of both.
    """
    f, source, target = transition.functions, transition.source.state, transition.target.state
    x, z, p = (cs.SX.sym(n, f["reset"].size1_in(i)) for i, n in enumerate("xzp"))
    xn = cs.SX.sym("xn", target.nx)
    K, r0 = f["implicit"](x, p)
    implicit = _Implicit(K, r0, transition.source.definite_size(transition.key) if transition.nz else 0)
    out, values, sizes = _Outputs(), f["reset"], {kind: len(rows) for kind, rows in transition.rows.items()}
    _sensitivity(out, implicit.elimination, *f["reset_d"](x, z, p, xn))
    if transition.num_rows:
        values = _make("reset", [x, z, p], [f["reset"](x, z, p), *f["rows"](x, z, p)])
        by = f["rows_d"](x, z, p)
        by_x, by_z = Nonzeros.of(cs.SX(cs.vertcat(*by[:3]))), Nonzeros.of(cs.SX(cs.vertcat(*by[3:])))
        by_z = by_z.moved(columns=implicit.elimination.place)
        out.add("rows_x", by_x.values, by_x.tables("rows_x"))
        out.add("rows_z", by_z.values, by_z.tables("rows_z"))
    functions = {
        "implicit": implicit.function([x, p]),
        "reset": values,
        "reset_d": out.function("reset_d", [x, z, p, xn]),
    }
    lines = defines(
        ID=number, NX=source.nx, NDX=source.ndx, NXN=target.nx, NDXN=target.ndx, NZ=transition.nz,
        NP=transition.layout.size, NR=sizes["residual"], NG=sizes["g"], NH=sizes["h"],
    )  # fmt: skip
    lines += ['#include "functions.h"', *implicit.elimination.tables(), *out.tables()]
    return Kernel(functions, "\n".join([*lines, '#include "transition.inc"', ""]))


def _make(name: str, inputs: list[cs.SX], outputs: list[cs.SX]) -> cs.Function:
    return cs.Function(name, inputs, outputs, {"cse": True})


class _Implicit:
    """The implicit part K z + r0 = 0, in the order and the blocks of its elimination."""

    def __init__(self, K: cs.SX, r0: cs.SX, definite: int) -> None:
        self.K, self.r0 = cs.SX(cs.sparsify(K)), cs.densify(r0)
        self.elimination = eliminate(self.K.sparsity(), definite)

    def function(self, inputs: list[cs.SX]) -> cs.Function:
        """Return the function whose outputs are the blocks of K, filled up with rows of the identity, and −r0."""
        order, place = self.elimination.order, self.elimination.place
        blocks, right = cs.SX.zeros(self.elimination.size), cs.SX.zeros(len(order))
        for row, unknown in enumerate(order):
            if unknown < 0:
                blocks[self.elimination.at(row, row)] = 1
            else:
                right[row] = -self.r0[unknown]
        nonzeros = Nonzeros.of(self.K)
        blocks[[self.elimination.at(place[r], place[c]) for r, c in nonzeros]] = nonzeros.values
        return _make("implicit", inputs, [blocks, right])


def _sensitivity(out: _Outputs, elimination: Elimination, r_w: cs.SX, d_w: cs.SX, d_z: cs.SX) -> None:
    """Add the parts of D = d_w − d_z K⁻¹ r_w. Rows of D that depend on z are dense, the others are sparse."""
    place, columns = elimination.place, d_w.size2()
    right = (-Nonzeros.of(r_w)).moved(rows=place)
    each = " ".join(f"DO({k}, {r}, {c})" for k, (r, c) in enumerate(right))
    # a macro, because a loop over a table takes longer than the rest of the function
    out.add("r_w", right.values, [f"#define EACH_r_w(DO) {each}"])
    by_z = Nonzeros.of(d_z).moved(columns=place)
    full = sorted(set(by_z.rows))
    ends = [sum(r <= row for r in by_z.rows) for row in full]
    lines = [f"#define NUM_FULL {len(full)}", table("full_row", full), table("full_end", ends)]
    out.add("d_z", by_z.values, [*lines, *by_z.tables("d_z")])
    by_w = Nonzeros.of(d_w)
    out.written["D"] = {row * columns + c for row in full for c in range(columns)} | set(_flat(by_w, columns))
    for name, own in (("d_set", by_w.where(lambda r, c: r not in full)), ("d_add", by_w.where(lambda r, c: r in full))):
        out.add(name, own.values, [f"#define NNZ_{name} {len(own)}", table(f"{name}_at", _flat(own, columns))])


def _model(out: _Outputs, elimination: Elimination, gradient: cs.SX, hessian: cs.SX, nw: int) -> None:
    """Add the gradient and the upper Hessian over (w, z), in separate parts for w, z and mixed derivatives.

    The rows of z with second derivatives are called *bent*: only these rows of Y = H_zw + H_zz Z are computed.
    """
    place = elimination.place
    out.add("gradient", gradient[:nw])
    by_z = Nonzeros.of(gradient[nw:]).moved(rows=place)
    out.add("gradient_z", by_z.values, by_z.tables("gradient_z"))
    H = Nonzeros.of(hessian)
    ww = H.where(lambda r, c: c < nw)
    wz = H.where(lambda r, c: r < nw <= c).moved(columns=[*range(nw), *(nw + k for k in place)])
    zz = Nonzeros.of(hessian[nw:, nw:]).moved(rows=place, columns=place)
    bent = sorted({c - nw for c in wz.columns} | {*zz.rows, *zz.columns})
    at = {row: number for number, row in enumerate(bent)}
    out.written["H"] = {r * nw + c for r in range(nw) for c in range(r, nw)} if bent else set(_flat(ww, nw))
    out.add("H_ww", ww.values, [f"#define NNZ_H_ww {len(ww)}", table("H_ww_at", _flat(ww, nw))])
    out.add("H_wz", wz.values, [
        f"#define NNZ_H_wz {len(wz)}", table("H_wz_row", wz.rows), table("H_wz_y", [at[c - nw] for c in wz.columns])
    ])  # fmt: skip
    both = sorted({(at[a], b, k) for k, (r, c) in enumerate(zz) for a, b in ((r, c), (c, r))})
    out.add("H_zz", zz.values, [
        f"#define NNZ_H_zz {len(both)}", *(table(f"H_zz_{name}", [entry[i] for entry in both])
                                           for i, name in enumerate(("y", "z", "from"))),
        f"#define NUM_BENT {len(bent)}", table("bent", bent),
    ])  # fmt: skip


def _flat(nonzeros: Nonzeros, columns: int) -> list[int]:
    """Return the positions of nonzeros in a row-major matrix."""
    return [r * columns + c for r, c in nonzeros]


def _contracted(J: cs.SX) -> tuple[cs.SX, cs.SX, cs.SX, cs.SX]:
    """Return symbols for slope and curvature of each row, and the gradient and upper Hessian of least squares."""
    J = cs.SX(cs.sparsify(J))
    slope, curvature = cs.SX.sym("slope", J.size1()), cs.SX.sym("curvature", J.size1())
    hessian = cs.triu(cs.mtimes(J.T, cs.mtimes(cs.diag(curvature), J)))
    return slope, curvature, cs.mtimes(J.T, slope), hessian
