"""The independent answer to linear-quadratic problems: all stages stacked into one dense KKT system, plain NumPy."""

import casadi as cs
import numpy as np

from piaffe.ocp import CompiledProblem
from piaffe.solvers import LqPhase

Array = np.ndarray
Pair = tuple[list[Array], list[Array]]


class Stack:
    """Minimise c + gᵀw + ½ wᵀHw subject to E w = e, filled block by block."""

    def __init__(self, size: int) -> None:
        self.H, self.g, self.c = np.zeros((size, size)), np.zeros(size), 0.0
        self.rows: list[Array] = []
        self.right: list[float] = []

    def squares(self, part: list[int], J: Array, r: Array, weight: Array) -> None:
        """Add ½ Σ weight (J w[part] + r)²."""
        self.quadratic(part, J.T @ (weight[:, None] * J), J.T @ (weight * r))
        self.c += 0.5 * float(weight @ r**2)

    def quadratic(self, part: list[int], H: Array, g: Array) -> None:
        """Add gᵀ w[part] + ½ w[part]ᵀ H w[part]."""
        self.H[np.ix_(part, part)] += H
        self.g[part] += g

    def equal(self, part: list[int], E: Array, right: Array) -> None:
        """Require E w[part] = right."""
        for row, value in zip(E, right, strict=True):
            full = np.zeros(len(self.g))
            full[part] = row
            self.rows.append(full)
            self.right.append(float(value))

    def cost(self, w: Array) -> float:
        """Return the value at w."""
        return float(self.c + self.g @ w + 0.5 * w @ self.H @ w)

    def solve(self) -> Array:
        """Return the minimiser."""
        E, e = np.array(self.rows), np.array(self.right)
        K = np.block([[self.H, E.T], [E, np.zeros((len(e), len(e)))]])
        return np.linalg.solve(K, np.concatenate([-self.g, e]))[: len(self.g)]


class Places:
    """Where states and controls of every phase lie in the stacked vector."""

    def __init__(self, sizes: list[tuple[int, int, int]]) -> None:
        self.sizes, self.size = sizes, 0
        self.x: list[list[list[int]]] = []
        self.u: list[list[list[int]]] = []
        for n, nx, nu in sizes:
            self.x.append([self._next(nx) for _ in range(n + 1)])
            self.u.append([self._next(nu) for _ in range(n)])

    def _next(self, count: int) -> list[int]:
        self.size += count
        return list(range(self.size - count, self.size))

    def split(self, w: Array) -> Pair:
        """Return states (N+1, nx) and controls (N, nu) of every phase."""
        states = [w[np.array(x)] for x in self.x]
        tables = zip(self.u, self.sizes, strict=True)
        return states, [w[np.array(u, dtype=int)].reshape(n, nu) for u, (n, _, nu) in tables]

    def join(self, states: list[Array], controls: list[Array]) -> Array:
        """Return the stacked vector."""
        w = np.zeros(self.size)
        for places, values in ((self.x, states), (self.u, controls)):
            for rows, table in zip(places, values, strict=True):
                for row, value in zip(rows, table, strict=True):
                    w[row] = value
        return w


def stack_models(phases: list[LqPhase]) -> tuple[Stack, Places]:
    """Return the dense problem of a linear-quadratic model, in δx and δu."""
    places = Places([(p.B.shape[0], p.B.shape[1], p.B.shape[2]) for p in phases])
    stack = Stack(places.size)
    for i, p in enumerate(phases):
        x, u, (n, nx, _) = places.x[i], places.u[i], places.sizes[i]
        if i == 0:
            stack.equal(x[0], np.eye(nx), p.d[0])
        for k in range(n):
            H = np.block([[p.l_xx[k], p.l_ux[k].T], [p.l_ux[k], p.l_uu[k]]])
            stack.quadratic(x[k] + u[k], H, np.concatenate([p.l_x[k], p.l_u[k]]))
            stack.equal(x[k + 1] + x[k] + u[k], np.hstack([np.eye(nx), -p.A[k], -p.B[k]]), p.d[k + 1])
        stack.quadratic(x[n], p.end_xx, p.end_x)
        if p.P is not None:
            following = phases[i + 1].d[0]
            stack.equal(places.x[i + 1][0] + x[n], np.hstack([np.eye(len(following)), -p.P]), following)
    return stack, places


def affine(function: cs.Function, sizes: tuple[int, ...], *fixed: Array) -> list[tuple[Array, Array]]:
    """Return (offset, matrix) of every output of an affine function of stacked arguments, from its values alone."""

    def values(w: Array) -> list[Array]:
        out = function(*np.split(w, np.cumsum(sizes)[:-1]), *fixed)
        return [np.asarray(o).ravel() for o in (out if isinstance(out, tuple) else (out,))]

    offsets = values(np.zeros(sum(sizes)))
    columns = [values(e) for e in np.eye(sum(sizes))]
    return [(o, np.array([c[j] - o for c in columns]).T) for j, o in enumerate(offsets)]


def stack_problem(problem: CompiledProblem) -> tuple[Stack, Places]:
    """Return the dense problem of a linear-quadratic declaration without implicit parts, in states and controls."""
    places = Places([(p.num_stages, p.mode.state.nx, p.mode.nu) for p in problem.phases])
    stack, none = Stack(places.size), np.zeros(0)
    stack.equal(places.x[0][0], np.eye(len(problem.initial)), problem.initial)
    for i, phase in enumerate(problem.phases):
        x, u, (n, nx, nu) = places.x[i], places.u[i], places.sizes[i]
        for k in range(n):
            (step, S), (r, J), *_ = affine(phase.mode.functions["stage"], (nx, nu), none, phase.p[k])
            stack.squares(x[k] + u[k], J, r, phase.dt * phase.weight[k])
            stack.equal(x[k + 1] + x[k] + u[k], np.hstack([np.eye(nx), -S]), step)
        (r, J), *_ = affine(phase.mode.functions["terminal"], (nx,), phase.p_end)
        stack.squares(x[n], J, r, phase.end_weight)
        if phase.transition is not None:
            ((start, P),) = affine(phase.transition.functions["reset"], (nx,), none, phase.p_transition)
            stack.equal(places.x[i + 1][0] + x[n], np.hstack([np.eye(len(start)), -P]), start)
    return stack, places
