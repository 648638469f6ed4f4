"""The roll-out of a step: along the line where the dynamics are linear, and by them where they are not."""

import numpy as np
import pytest

from piaffe.ocp import compile_problem
from piaffe.solvers import MSiLQR
from piaffe.solvers.ilqr.iterate import Iterate
from piaffe.solvers.ilqr.riccati import backward, roll_out
from piaffe.solvers.ilqr.rollout import move
from piaffe.solvers.ilqr.run import Run

from ...problems import PROBLEMS, linear_quadratic


def simulated(solver: MSiLQR, seed: int) -> Iterate:
    """Return the iterate that random controls lead to, without a defect."""
    rng = np.random.default_rng(seed)
    phases = solver.problem.phases
    controls = [rng.normal(size=p.guess_controls.shape) for p in phases]
    zero = [np.zeros((p.num_stages + 1, p.mode.state.ndx)) for p in phases]
    start = Iterate([p.guess_states for p in phases], controls)
    return move(solver.functions, start, zero, [np.zeros_like(u) for u in controls], 0.0, solver.flags(False))


@pytest.mark.parametrize("size", [1.0, 0.5, 0.01])
@pytest.mark.parametrize("every", [1, 3, 100])
def test_a_step_of_a_linear_problem_is_on_the_line_whichever_nodes_shoot(size: float, every: int) -> None:
    solver = MSiLQR(compile_problem(linear_quadratic()))
    start = simulated(solver, 0)
    run = Run(solver.functions, solver.options, start, solver.flags(True), None)
    models = run.linearise()
    sweeps = backward(models, 0.0)
    assert sweeps is not None
    step = roll_out(models, sweeps)
    flags = [np.arange(p.num_stages + 1) % every == 1 for p in solver.problem.phases]
    moved = move(solver.functions, start, step.dx, step.du, size, flags, [sweep.feedback for sweep in sweeps])
    for got, old, change in zip(moved.states, start.states, step.dx, strict=True):
        np.testing.assert_allclose(got, old + size * change, atol=1e-10)
    for got, old, change in zip(moved.controls, start.controls, step.du, strict=True):
        np.testing.assert_allclose(got, old + size * change, atol=1e-10)


@pytest.mark.parametrize("name", ["flying body", "rope"])
def test_nodes_that_do_not_shoot_follow_the_dynamics_under_the_policy(name: str) -> None:
    """u = ū + α δu + K ((x ⊖ x̄) − α δx) of the state that is reached, step by step through CasADi's own functions."""
    solver = MSiLQR(compile_problem(PROBLEMS[name]()))
    start, size = simulated(solver, 1), 0.3
    run = Run(solver.functions, solver.options, start, solver.flags(True), None)
    models = run.linearise()
    sweeps = backward(models, 1.0)
    assert sweeps is not None
    step = roll_out(models, sweeps)
    moved = move(
        solver.functions, start, step.dx, step.du, size, solver.flags(False), [sweep.feedback for sweep in sweeps]
    )
    x = solver.problem.initial
    for i, phase in enumerate(solver.problem.phases):
        f, space = phase.mode.functions, phase.mode.state
        for k in range(phase.num_stages):
            np.testing.assert_allclose(moved.states[i][k], x, atol=1e-8)
            off = space.np_minus(x, start.states[i][k]) - size * step.dx[i][k]
            u = start.controls[i][k] + size * step.du[i][k] + sweeps[i].feedback[k] @ off
            np.testing.assert_allclose(moved.controls[i][k], u, atol=1e-7)
            K, r = (a.full() for a in f["implicit"](x, u, phase.p[k]))
            z = -np.linalg.solve(K, r) if r.size else r
            x = f["stage"](x, u, z, phase.p[k])[0].full().ravel()
        if phase.transition is not None:
            t, p = phase.transition.functions, phase.p_transition
            K, r = (a.full() for a in t["implicit"](x, p))
            x = t["reset"](x, -np.linalg.solve(K, r) if r.size else r, p).full().ravel()
