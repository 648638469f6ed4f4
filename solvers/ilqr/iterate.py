"""Iterates: states and controls of every phase, values of the problem's functions, the linear-quadratic model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import CompiledPhase, CompiledProblem, Vectorised

from . import barrier
from .riccati import LqPhase

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Iterate:
    """States (N+1, nx) and controls (N, nu) of every phase."""

    states: list[Array]
    controls: list[Array]


@dataclass(frozen=True, eq=False)
class PhaseValues:
    """Values of the functions of one phase at an iterate.

    Args:
        z: implicit variables (N, nz). K: their matrices (N, nz, nz).
        x_next: (N, nx). residual, g, h: rows (N, ·). end_residual, end_g, end_h: rows of the last node, those of the
            transition included, see :meth:`CompiledPhase.end_rows`.
        z_reset, K_reset: the transition's implicit variables and matrix. x_reset: first state of the next phase.
    """

    z: Array
    K: Array
    x_next: Array
    residual: Array
    g: Array
    h: Array
    end_residual: Array
    end_g: Array
    end_h: Array
    z_reset: Array
    K_reset: Array
    x_reset: Array


@dataclass(eq=False)
class PhaseDual:
    """Relaxations δ and shifts s of one phase's inequalities; multipliers λ and penalties σ of its equalities."""

    relaxation: Array
    end_relaxation: Array
    shift: Array
    end_shift: Array
    multiplier: Array
    penalty: Array
    end_multiplier: Array
    end_penalty: Array

    def stored(self) -> dict[str, Array]:
        """Return the arrays that a warm start uses, by their names in a solution."""
        return {
            "equality": self.multiplier, "end_equality": self.end_multiplier, "penalty": self.penalty,
            "end_penalty": self.end_penalty, "relaxation": self.relaxation, "end_relaxation": self.end_relaxation,
            "shift": self.shift, "end_shift": self.end_shift,
        }  # fmt: skip


def solve_nodes(K: Array, r: Array) -> Array:
    """Return K⁻¹ r node by node for r of shape (n, nz) or (n, nz, m); NaN if some K is singular.

    Rows and columns of K are divided by powers of two near their largest entries. So the error does not depend on the
    units of z and of the equations, which for a robot of centimetres are far from 1.
    """
    if r.shape[1] == 0:
        return r
    columns = r[:, :, None] if r.ndim == 2 else r
    by_row = _powers(np.max(np.abs(K), axis=2, keepdims=True))
    K = K * by_row
    by_column = _powers(np.max(np.abs(K), axis=1, keepdims=True))
    try:
        solved: Array = np.asarray(np.linalg.solve(K * by_column, columns * by_row), dtype=float)
    except np.linalg.LinAlgError:
        solved = np.full(columns.shape, np.nan)
    return (solved * by_column.swapaxes(1, 2)).reshape(r.shape)


def _powers(sizes: Array) -> Array:
    """Return powers of two near 1 / sizes; 1 for sizes that are zero or not finite."""
    usable = np.where((sizes > 0) & np.isfinite(sizes), sizes, 1.0)
    return np.exp2(-np.round(np.log2(usable)))


class ProblemFunctions:
    """The functions of a compiled problem, evaluated at all nodes of a phase at once, in NumPy."""

    def __init__(self, problem: CompiledProblem) -> None:
        self.problem = problem
        self.ridges = [ridge(phase) for phase in problem.phases]
        self._vectorised: dict[int, Vectorised] = {}

    def call(self, function: Any, *arguments: Array) -> list[Array]:
        """Evaluate a CasADi function over stacked nodes."""
        if id(function) not in self._vectorised:
            self._vectorised[id(function)] = Vectorised(function)
        return self._vectorised[id(function)](*arguments)

    def values(self, i: int, x: Array, u: Array) -> PhaseValues:
        """Return the values of the functions of phase i."""
        phase = self.problem.phases[i]
        f = phase.mode.functions
        K, r0 = self.call(f["implicit"], x[:-1], u, phase.p)
        z = -solve_nodes(K, r0)
        x_next, residual, g, h = self.call(f["stage"], x[:-1], u, z, phase.p)
        end = [a[0] for a in self.call(f["terminal"], x[-1:], phase.p_end[None])]
        z_reset, K_reset, x_reset = np.zeros(0), np.zeros((0, 0)), np.zeros(0)
        if phase.transition is not None:
            t, p = phase.transition.functions, phase.p_transition[None]
            K_all, r_all = self.call(t["implicit"], x[-1:], p)
            z_all = -solve_nodes(K_all, r_all)
            (x_all,) = self.call(t["reset"], x[-1:], z_all, p)
            z_reset, K_reset, x_reset = z_all[0], K_all[0], x_all[0]
            if phase.transition.num_rows:
                added = self.call(t["rows"], x[-1:], z_all, p)
                end = [
                    np.concatenate([own, np.where(used, more[0], 0.0)])
                    for own, more, used in zip(end, added, added_rows_in_use(phase), strict=True)
                ]
        return PhaseValues(z, K, x_next, residual, g, h, end[0], end[1], end[2], z_reset, K_reset, x_reset)

    def all_values(self, iterate: Iterate) -> list[PhaseValues]:
        """Return the values of the functions of every phase."""
        return [self.values(i, x, u) for i, (x, u) in enumerate(zip(iterate.states, iterate.controls, strict=True))]

    def defects(self, iterate: Iterate, values: list[PhaseValues]) -> list[Array]:
        """Return the defects of every phase, (N+1, ndx); row 0 is the initial state's or the reset map's."""
        out, start = [], self.problem.initial
        for phase, x, value in zip(self.problem.phases, iterate.states, values, strict=True):
            out.append(phase.mode.state.np_minus(np.vstack([start[None], value.x_next]), x))
            start = value.x_reset
        return out

    def step(self, i: int, k: int, x: Array, u: Array) -> Array:
        """Return the state after stage k of phase i, (nx,)."""
        phase = self.problem.phases[i]
        f, p = phase.mode.functions, phase.p[k : k + 1]
        K, r0 = self.call(f["implicit"], x[None], u[None], p)
        after: Array = self.call(f["stage"], x[None], u[None], -solve_nodes(K, r0), p)[0][0]
        return after

    def reset(self, i: int, x: Array) -> Array:
        """Return the first state of the phase after phase i, (nx,)."""
        phase = self.problem.phases[i]
        assert phase.transition is not None  # only called for a phase with a following one
        t, p = phase.transition.functions, phase.p_transition[None]
        K, r0 = self.call(t["implicit"], x[None], p)
        first: Array = self.call(t["reset"], x[None], -solve_nodes(K, r0), p)[0][0]
        return first

    # ---- the linear-quadratic model

    def lq(
        self,
        i: int,
        iterate: Iterate,
        value: PhaseValues,
        defect: Array,
        dual: PhaseDual,
        weight: float,
        share: float = 1.0,
    ) -> LqPhase:
        """Return the Gauss-Newton model of phase i: a share of the cost, barrier ε = ``weight``, penalties."""
        phase = self.problem.phases[i]
        x, u, f, dt = iterate.states[i], iterate.controls[i], phase.mode.functions, phase.dt
        ndx = phase.mode.state.ndx
        r_w, d_w, res_w, g_w, h_w, d_z, res_z, g_z, h_z = self.call(f["stage_d"], x[:-1], u, value.z, phase.p, x[1:])
        if phase.mode.nz:
            z_w = -solve_nodes(value.K, r_w)
            d_w, res_w, g_w, h_w = d_w + d_z @ z_w, res_w + res_z @ z_w, g_w + g_z @ z_w, h_w + h_z @ z_w
        stage_h = phase.h_mask * dt
        rows = np.concatenate([res_w, g_w, h_w], axis=1)
        slopes = np.concatenate([
            dt * share * phase.weight * value.residual,
            dt * weight * masked(phase.g_mask, barrier.slope(value.g - dual.shift, dual.relaxation)),
            masked(stage_h, dual.penalty * value.h + dual.multiplier),
        ], axis=1)  # fmt: skip
        curvatures = np.concatenate([
            dt * share * phase.weight,
            dt * weight * masked(phase.g_mask, barrier.curvature(value.g - dual.shift, dual.relaxation)),
            stage_h * dual.penalty,
        ], axis=1)  # fmt: skip
        gradient = np.einsum("nr,nrw->nw", slopes, rows)
        hessian = rows.swapaxes(1, 2) @ (curvatures[:, :, None] * rows)
        end_rows = self.end_jacobians(i, iterate, value)
        end_slopes = [
            share * phase.end_weight * value.end_residual,
            dt * weight * masked(phase.end_g_mask, barrier.slope(value.end_g - dual.end_shift, dual.end_relaxation)),
            masked(phase.end_h_mask, dual.end_penalty * value.end_h + dual.end_multiplier),
        ]
        end_curvatures = [
            share * phase.end_weight,
            dt
            * weight
            * masked(phase.end_g_mask, barrier.curvature(value.end_g - dual.end_shift, dual.end_relaxation)),
            phase.end_h_mask * dual.end_penalty,
        ]
        return LqPhase(
            A=d_w[:, :, :ndx], B=d_w[:, :, ndx:], d=defect,
            l_x=gradient[:, :ndx], l_u=gradient[:, ndx:],
            l_xx=hessian[:, :ndx, :ndx], l_ux=hessian[:, ndx:, :ndx], l_uu=hessian[:, ndx:, ndx:],
            end_x=sum((J.T @ s for J, s in zip(end_rows, end_slopes, strict=True)), np.zeros(ndx)),
            end_xx=sum(
                (J.T @ (c[:, None] * J) for J, c in zip(end_rows, end_curvatures, strict=True)), np.zeros((ndx, ndx))
            ),
            P=self.reset_jacobian(i, iterate, value), ridge=self.ridges[i],
        )  # fmt: skip

    def end_jacobians(self, i: int, iterate: Iterate, value: PhaseValues) -> list[Array]:
        """Return the Jacobians of residual, g and h of the last node of phase i, see ``CompiledPhase.end_rows``."""
        phase, x = self.problem.phases[i], iterate.states[i][-1:]
        own = [a[0] for a in self.call(phase.mode.functions["terminal_d"], x, phase.p_end[None])]
        if phase.transition is None or not phase.transition.num_rows:
            return own
        t, p, xn = phase.transition.functions, phase.p_transition[None], iterate.states[i + 1][:1]
        z = value.z_reset[None]
        r_x, *_ = self.call(t["reset_d"], x, z, p, xn)
        z_x = -solve_nodes(value.K_reset[None], r_x)[0]
        by = [a[0] for a in self.call(t["rows_d"], x, z, p)]
        added = [
            np.where(used[:, None], by_x + by_z @ z_x, 0.0)
            for by_x, by_z, used in zip(by[:3], by[3:], added_rows_in_use(phase), strict=True)
        ]
        return [np.concatenate(both) for both in zip(own, added, strict=True)]

    def reset_jacobian(self, i: int, iterate: Iterate, value: PhaseValues) -> Array | None:
        """Return the Jacobian of the transition after phase i, at its current defect."""
        phase = self.problem.phases[i]
        if phase.transition is None:
            return None
        r_x, d_x, d_z = self.call(
            phase.transition.functions["reset_d"],
            iterate.states[i][-1:], value.z_reset[None], phase.p_transition[None], iterate.states[i + 1][:1],
        )  # fmt: skip
        if phase.transition.nz:
            d_x = d_x - d_z @ solve_nodes(value.K_reset[None], r_x)
        jacobian: Array = d_x[0]
        return jacobian


def ridge(phase: CompiledPhase) -> Array:
    """Return what a regularisation of 1 adds to the diagonal of the Hessian: 1 / the natural sizes², (ndx + nu,)."""
    sizes: Array = np.concatenate([phase.mode.state_sizes, phase.mode.control_sizes])
    return sizes**-2.0


def added_rows_in_use(phase: CompiledPhase) -> list[NDArray[np.bool_]]:
    """Return which rows of the transition after a phase have an effect, by kind: those of feet that land."""
    own = (len(phase.mode.rows[f"terminal_{kind}"]) for kind in ("residual", "g", "h"))
    factors = (phase.end_weight, phase.end_g_mask, phase.end_h_mask)
    return [factor[first:] > 0 for factor, first in zip(factors, own, strict=True)]


def running_cost(phase: CompiledPhase, value: PhaseValues) -> float:
    """Return the declared cost of a phase: stages times dt, and its end."""
    stages = 0.5 * phase.dt * np.sum(phase.weight * value.residual**2)
    return float(stages + 0.5 * np.sum(phase.end_weight * value.end_residual**2))


def penalty_cost(phase: CompiledPhase, value: PhaseValues, dual: PhaseDual, weight: float) -> float:
    """Return the barrier and augmented-Lagrangian cost of a phase."""
    dt = phase.dt
    total = dt * weight * np.sum(masked(phase.g_mask, barrier.value(value.g - dual.shift, dual.relaxation)))
    end_g = barrier.value(value.end_g - dual.end_shift, dual.end_relaxation)
    total += dt * weight * np.sum(masked(phase.end_g_mask, end_g))
    total += dt * np.sum(masked(phase.h_mask, 0.5 * dual.penalty * value.h**2 + dual.multiplier * value.h))
    end = 0.5 * dual.end_penalty * value.end_h**2 + dual.end_multiplier * value.end_h
    return float(total + np.sum(masked(phase.end_h_mask, end)))


def masked(mask: Array, rows: Array) -> Array:
    """Return rows times their masks; a row with mask 0 is zero even if its value is not finite."""
    return np.where(mask > 0, mask * rows, 0.0)
