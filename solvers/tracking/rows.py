"""Rows of a mode that depend on the control, as functions of the control alone.

The implicit part r = r0 + K z = 0 gives z = −K⁻¹ r0 of a control, and Z = ∂z/∂u = −K⁻¹ ∂r/∂u. A row g(x, u, z) ≥ 0 then
becomes g(x, ū, z̄) + (g_u + g_z Z) δu ≥ 0, which is exact for rows that are affine in u and z.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import LoweredMode, Vectorised

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Condensed:
    """Rows of the quadratic program in δu at one state: equality A δu = b, inequality C δu ≥ d.

    Args:
        z: implicit part at (x, ū) (nz,).
        z_u: Z (nz, nu).
        A: (m, nu).
        b: (m,).
        C: (k, nu).
        d: (k,).
        rows: index of each inequality among the mode's rows, (k,).
        soft: whether each inequality depends on the implicit part, (k,).
    """

    z: Array
    z_u: Array
    A: Array
    b: Array
    C: Array
    d: Array
    rows: NDArray[np.int_]
    soft: NDArray[np.bool_]


class ControlRows:
    """The rows of a mode's stages that depend on control or implicit part.

    Args:
        mode: the mode.

    Attributes:
        g: indices of its inequality rows. h: indices of its equality rows.
        not_affine: those of ``g`` that are not affine in u and z; they are linearised.
        bounds: (row, control) of the inequality rows that bound one control alone.
        left_out: indices of the inequality rows that depend on the state alone.
        soft: for each row of ``g``, whether it depends on the implicit part: a limit on forces of contact.
    """

    def __init__(self, mode: LoweredMode) -> None:
        f, space = mode.functions, mode.state
        x, u, z, p = (
            cs.SX.sym(n, k) for n, k in (("x", space.nx), ("u", mode.nu), ("z", mode.nz), ("p", mode.layout.size))
        )
        stage = f["stage"].call({"x": x, "u": u, "z": z, "p": p})
        implicit = f["implicit"].call({"x": x, "u": u, "p": p})
        uz = cs.vertcat(u, z)
        self.g, by_g, found = _dependent(stage["g"], uz)
        self.h, by_h, found_h = _dependent(stage["h"], uz)
        nu = mode.nu
        curved = (
            {row for row, J in zip(self.g, cs.vertsplit(by_g), strict=True) if cs.depends_on(J, uz)}
            if self.g
            else set()
        )
        self.not_affine = tuple(sorted(curved))
        pattern = by_g.sparsity()
        columns: dict[int, list[int]] = {}
        for row, column in zip(pattern.row(), pattern.get_col(), strict=True):
            columns.setdefault(row, []).append(column)
        self.bounds = tuple(
            (self.g[i], own[0])
            for i, own in sorted(columns.items())
            if len(own) == 1 and own[0] < nu and self.g[i] not in curved
        )
        self.soft = np.array([max(columns.get(i, [0])) >= nu for i in range(len(self.g))], dtype=bool)
        every = len(mode.rows["stage_g"])
        self.left_out = tuple(i for i in range(every) if i not in set(self.g))
        self.symbols, self.by_g, self.by_h, self.values = (x, u, z, p), by_g, by_h, (found, found_h)
        r_w = cs.jacobian(implicit["r0"] + implicit["K"] @ z, u)
        self.system = implicit["K"], implicit["r0"], r_w
        self._implicit = Vectorised(
            cs.Function(
                "condensed",
                [x, u, z, p],
                [implicit["K"], cs.densify(implicit["r0"]), cs.sparsify(r_w)],
                ["x", "u", "z", "p"],
                ["K", "r0", "r_w"],
            )
        )
        outs = {
            "g": cs.densify(found), "h": cs.densify(found_h), "g_w": by_g[:, :nu], "g_z": by_g[:, nu:],
            "h_w": by_h[:, :nu], "h_z": by_h[:, nu:],
        }  # fmt: skip
        self._rows = Vectorised(
            cs.Function(
                "control_rows", [x, u, z, p], list(outs.values()), ["x", "u", "z", "p"], list(outs), {"cse": True}
            )
        )
        self._masks = Vectorised(f["stage_w"])
        self.mode = mode

    def limits(self, x: Array, p: Array, g_mask: Array) -> tuple[Array, Array]:
        """Return the declared bounds of single controls, lower and upper (nu,); infinite without a bound.

        Args:
            x: state (nx,).
            p: parameters (np,).
            g_mask: rows with 0 are left out (ng,).
        """
        nu = self.mode.nu
        lower, upper = np.full(nu, -np.inf), np.full(nu, np.inf)
        if not self.bounds:
            return lower, upper
        g, _, g_u, *_ = self._rows(x[None], np.zeros((1, nu)), np.zeros((1, self.mode.nz)), p[None])
        for row, control in self.bounds:
            i = self.g.index(row)
            slope = g_u[0, i, control]
            if g_mask[row] > 0 and slope > 0:
                lower[control] = max(lower[control], -g[0, i] / slope)
            elif g_mask[row] > 0 and slope < 0:
                upper[control] = min(upper[control], -g[0, i] / slope)
        return lower, upper

    def masks(self, p: Array) -> tuple[Array, Array]:
        """Return the masks of all rows for parameters (n, np): inequality (n, ng) and equality (n, nh)."""
        _, g, h = self._masks(p)
        return g, h

    def __call__(self, x: Array, u: Array, p: Array, g_mask: Array, h_mask: Array) -> Condensed:
        """Return the rows about a control.

        Args:
            x: measured state (nx,).
            u: ū (nu,).
            p: parameters (np,).
            g_mask: rows with 0 are left out (ng,).
            h_mask: the same for equalities (nh,).
        """
        z, z_u = self._solve(x, u, p)
        g, h, g_u, g_z, h_u, h_z = (part[0] for part in self._rows(x[None], u[None], z[None], p[None]))
        use, hold = g_mask[list(self.g)] > 0, h_mask[list(self.h)] > 0
        return Condensed(
            z, z_u, (h_u + h_z @ z_u)[hold], -h[hold], (g_u + g_z @ z_u)[use], -g[use], np.array(self.g, int)[use],
            self.soft[use],
        )  # fmt: skip

    def _solve(self, x: Array, u: Array, p: Array) -> tuple[Array, Array]:
        """Return z and ∂z/∂u; NaN if the equations have no solution."""
        nz, nu = self.mode.nz, self.mode.nu
        if nz == 0:
            return np.zeros(0), np.zeros((0, nu))
        nothing = np.zeros((1, nz))
        K, r0, _ = self._implicit(x[None], u[None], nothing, p[None])
        try:
            z = -np.linalg.solve(K[0], r0[0])
            r_u = self._implicit(x[None], u[None], z[None], p[None])[2][0]
            return z, -np.linalg.solve(K[0], r_u)
        except np.linalg.LinAlgError:
            return np.full(nz, np.nan), np.full((nz, nu), np.nan)


def _dependent(rows: cs.SX, uz: cs.SX) -> tuple[tuple[int, ...], cs.SX, cs.SX]:
    """Return indices, Jacobian and values of the rows that depend on some symbols."""
    kept = tuple(sorted(set(cs.jacobian_sparsity(rows, uz).row()))) if rows.numel() else ()
    own = rows[list(kept)] if kept else cs.SX(0, 1)
    return kept, cs.sparsify(cs.jacobian(own, uz)), own
