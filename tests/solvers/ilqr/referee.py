"""A second solver: the compiled problem as one sparse nonlinear program for Ipopt."""

from dataclasses import dataclass

import casadi as cs
import numpy as np

from piaffe.ocp import CompiledProblem


@dataclass(frozen=True)
class Verdict:
    """What Ipopt found: the cost, and the states and controls of every phase."""

    cost: float
    states: list[np.ndarray]
    controls: list[np.ndarray]


def implicit(function: cs.Function, *arguments: object) -> object:
    """Return z = −K⁻¹ r0."""
    K, r0 = function(*arguments)
    return -cs.solve(K, r0) if r0.numel() else cs.DM.zeros(0)


def referee(problem: CompiledProblem, start: tuple[list[np.ndarray], list[np.ndarray]] | None = None) -> Verdict:
    """Return Ipopt's optimum of a problem with explicit models, from its initial guess or from ``start``."""
    states, controls = start or ([p.guess_states for p in problem.phases], [p.guess_controls for p in problem.phases])
    w, w0, cost, rows, lower, upper = [], [], 0, [], [], []

    def constrain(expression, mask, highest):
        for i in np.flatnonzero(mask):
            rows.append(expression[int(i)])
            lower.append(0.0)
            upper.append(highest)

    before, shapes = cs.DM(problem.initial), []
    for phase, x0, u0 in zip(problem.phases, states, controls, strict=True):
        f, n = phase.mode.functions, phase.num_stages
        X, U = cs.MX.sym("X", x0.shape[1], n + 1), cs.MX.sym("U", u0.shape[1], n)
        w += [cs.vec(X), cs.vec(U)]
        w0 += [x0.ravel(), u0.ravel()]
        shapes.append((x0.shape, u0.shape))
        constrain(X[:, 0] - before, np.ones(X.shape[0]), 0.0)
        for k in range(n):
            z = implicit(f["implicit"], X[:, k], U[:, k], phase.p[k])
            x_next, residual, g, h = f["stage"](X[:, k], U[:, k], z, phase.p[k])
            constrain(X[:, k + 1] - x_next, np.ones(X.shape[0]), 0.0)
            constrain(g, phase.g_mask[k], np.inf)
            constrain(h, phase.h_mask[k], 0.0)
            cost += 0.5 * phase.dt * cs.dot(phase.weight[k], residual**2)
        residual, g, h = f["terminal"](X[:, n], phase.p_end)
        if phase.transition is not None:
            t, p = phase.transition.functions, phase.p_transition
            z = implicit(t["implicit"], X[:, n], p)
            before = t["reset"](X[:, n], z, p)
            more = t["rows"](X[:, n], z, p)
            residual, g, h = (cs.vertcat(own, added) for own, added in zip((residual, g, h), more, strict=True))
        cost += 0.5 * cs.dot(phase.end_weight, residual**2)
        constrain(g, phase.end_g_mask, np.inf)
        constrain(h, phase.end_h_mask, 0.0)
    program = {"x": cs.vertcat(*w), "f": cost, "g": cs.vertcat(*rows)}
    quiet = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10, "bound_relax_factor": 0.0}}
    solver = cs.nlpsol("referee", "ipopt", program, quiet)
    result = solver(x0=np.concatenate(w0), lbg=np.array(lower), ubg=np.array(upper))
    assert solver.stats()["success"], solver.stats()["return_status"]
    flat, out_x, out_u = np.asarray(result["x"]).ravel(), [], []
    for shape_x, shape_u in shapes:
        nx, nu = shape_x[0] * shape_x[1], shape_u[0] * shape_u[1]
        out_x.append(flat[:nx].reshape(shape_x))
        out_u.append(flat[nx : nx + nu].reshape(shape_u))
        flat = flat[nx + nu :]
    return Verdict(float(result["f"]), out_x, out_u)
