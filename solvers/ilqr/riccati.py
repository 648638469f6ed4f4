"""The linear-quadratic sub-problem of one iteration and its Riccati sweep.

Stage k of a phase: δx⁺ = A δx + B δu + d,  cost ½ [δx; δu]ᵀ [[Q_xx, ·], [Q_ux, Q_uu]] [δx; δu] + gradients.
The policy is δu = k + K δx; the value function of node k is V(δx) = ½ δxᵀ V_xx δx + V_xᵀ δx + const.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LqPhase:
    """The linear-quadratic model of one phase with N stages.

    Args:
        A: (N, ndx, ndx). B: (N, ndx, nu).
        d: defects of nodes 0..N, (N+1, ndx); row 0 is the initial state's or the reset map's.
        l_x: (N, ndx). l_u: (N, nu). l_xx: (N, ndx, ndx). l_ux: (N, nu, ndx). l_uu: (N, nu, nu).
        end_x: gradient at the last node (ndx,). end_xx: Hessian (ndx, ndx).
        P: Jacobian of the reset map to the next phase (ndx of the next, ndx); None at the horizon's end.
        ridge: what a regularisation of 1 adds to the diagonal of the Hessian, (ndx + nu,); None for ones.
    """

    A: Array
    B: Array
    d: Array
    l_x: Array
    l_u: Array
    l_xx: Array
    l_ux: Array
    l_uu: Array
    end_x: Array
    end_xx: Array
    P: Array | None
    ridge: Array | None = None

    @property
    def is_finite(self) -> bool:
        """Whether every number of the model is finite."""
        parts = (
            self.A, self.B, self.d, self.l_x, self.l_u, self.l_xx, self.l_ux, self.l_uu, self.end_x, self.end_xx,
            *(() if self.P is None else (self.P,)),
        )  # fmt: skip
        return all(bool(np.all(np.isfinite(part))) for part in parts)


@dataclass(frozen=True, eq=False)
class Sweep:
    """Result of the backward sweep for one phase: feedforward k (N, nu), feedback K (N, nu, ndx), V and Q."""

    feedforward: Array
    feedback: Array
    V_x: Array
    V_xx: Array
    Q_x: Array
    Q_u: Array
    Q_xx: Array
    Q_ux: Array
    Q_uu: Array


def backward(phases: list[LqPhase], regularization: float) -> list[Sweep] | None:
    """Return the sweep of every phase, or None if some Q_uu is not positive definite.

    V_x and V_xx of node k do *not* include the defect of that node: V is the value of a deviation δx from the nominal
    state X̄_k.
    """
    sweeps: list[Sweep] = []
    gradient = hessian = None  # of the next phase's first node, defect included
    for phase in reversed(phases):
        n, ndx, nu = phase.B.shape
        k, K = np.zeros((n, nu)), np.zeros((n, nu, ndx))
        V_x, V_xx = np.zeros((n + 1, ndx)), np.zeros((n + 1, ndx, ndx))
        Q_x, Q_u = np.zeros((n, ndx)), np.zeros((n, nu))
        Q_xx, Q_ux, Q_uu = np.zeros((n, ndx, ndx)), np.zeros((n, nu, ndx)), np.zeros((n, nu, nu))
        V_x[n], V_xx[n] = phase.end_x, phase.end_xx
        if phase.P is not None and gradient is not None and hessian is not None:
            V_x[n] = V_x[n] + phase.P.T @ gradient
            V_xx[n] = V_xx[n] + phase.P.T @ hessian @ phase.P
        ridge = regularization * (np.ones(ndx + nu) if phase.ridge is None else phase.ridge)
        ridge_x, ridge_u = np.diag(ridge[:ndx]), np.diag(ridge[ndx:])
        for i in range(n - 1, -1, -1):
            A, B, H = phase.A[i], phase.B[i], V_xx[i + 1]
            g = V_x[i + 1] + H @ phase.d[i + 1]
            HA, HB = H @ A, H @ B
            Q_x[i] = phase.l_x[i] + A.T @ g
            Q_u[i] = phase.l_u[i] + B.T @ g
            Q_xx[i] = phase.l_xx[i] + A.T @ HA + ridge_x
            Q_ux[i] = phase.l_ux[i] + B.T @ HA
            Q_uu[i] = phase.l_uu[i] + B.T @ HB + ridge_u
            if nu:
                Q_uu[i] = 0.5 * (Q_uu[i] + Q_uu[i].T)
                try:
                    L = np.linalg.cholesky(Q_uu[i])
                except np.linalg.LinAlgError:
                    return None
                both = np.linalg.solve(L, np.column_stack([Q_u[i], Q_ux[i]]))
                step = -np.linalg.solve(L.T, both)
                k[i], K[i] = step[:, 0], step[:, 1:]
            V_x[i] = Q_x[i] + Q_ux[i].T @ k[i]
            S = Q_xx[i] + Q_ux[i].T @ K[i]
            V_xx[i] = 0.5 * (S + S.T)
        gradient, hessian = V_x[0] + V_xx[0] @ phase.d[0], V_xx[0]
        if not (np.all(np.isfinite(gradient)) and np.all(np.isfinite(k))):
            return None
        sweeps.append(Sweep(k, K, V_x, V_xx, Q_x, Q_u, Q_xx, Q_ux, Q_uu))
    return sweeps[::-1]


@dataclass(frozen=True, eq=False)
class Direction:
    """The linear roll-out at full step: δx (N+1, ndx) and δu (N, nu) of every phase, and the expected cost change.

    The model predicts the change α dV1 + ½ α² dV2 of the cost for a step α; it includes every cost term.
    """

    dx: list[Array]
    du: list[Array]
    dV1: float
    dV2: float


def roll_out(phases: list[LqPhase], sweeps: list[Sweep]) -> Direction:
    """Return the linear roll-out of the policy, which closes all defects of the linear model."""
    dxs, dus, dV1, dV2 = [], [], 0.0, 0.0
    first = phases[0].d[0]
    for phase, sweep in zip(phases, sweeps, strict=True):
        n, ndx, nu = phase.B.shape
        dx, du = np.zeros((n + 1, ndx)), np.zeros((n, nu))
        dx[0] = first
        for i in range(n):
            du[i] = sweep.feedforward[i] + sweep.feedback[i] @ dx[i]
            dx[i + 1] = phase.A[i] @ dx[i] + phase.B[i] @ du[i] + phase.d[i + 1]
        dV1 += float(np.sum(phase.l_x * dx[:-1]) + np.sum(phase.l_u * du) + phase.end_x @ dx[n])
        dV2 += float(
            np.einsum("ni,nij,nj->", dx[:-1], phase.l_xx, dx[:-1])
            + 2 * np.einsum("ni,nij,nj->", du, phase.l_ux, dx[:-1])
            + np.einsum("ni,nij,nj->", du, phase.l_uu, du)
            + dx[n] @ phase.end_xx @ dx[n]
        )
        dxs.append(dx)
        dus.append(du)
        if phase.P is not None:
            following = phases[len(dxs)]
            first = phase.P @ dx[n] + following.d[0]
    return Direction(dxs, dus, dV1, dV2)


def close_defects(phases: list[LqPhase], sweeps: list[Sweep], defects: list[Array]) -> tuple[list[Array], list[Array]]:
    """Return the step that closes given defects in the linear model, with the feedback and without the feedforward.

    It is the second-order correction of a trial step whose defects grow because of curvature.
    """
    dxs, dus, first = [], [], defects[0][0]
    for i, (phase, sweep, defect) in enumerate(zip(phases, sweeps, defects, strict=True)):
        n, ndx, nu = phase.B.shape
        dx, du = np.zeros((n + 1, ndx)), np.zeros((n, nu))
        dx[0] = first
        for k in range(n):
            du[k] = sweep.feedback[k] @ dx[k]
            dx[k + 1] = phase.A[k] @ dx[k] + phase.B[k] @ du[k] + defect[k + 1]
        dxs.append(dx)
        dus.append(du)
        if phase.P is not None:
            first = phase.P @ dx[n] + defects[i + 1][0]
    return dxs, dus
