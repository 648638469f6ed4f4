"""The linear-quadratic model of an iterate against finite differences, on the manifold, through implicit parts."""

from itertools import pairwise

import numpy as np
import pytest

from piaffe.ocp import Problem, compile_problem, equality
from piaffe.solvers import LqPhase, MSiLQR
from piaffe.solvers.ilqr import barrier
from piaffe.solvers.ilqr.iterate import Iterate
from piaffe.solvers.ilqr.run import Run

from ...problems import PROBLEMS, linear_quadratic, rope, tumbling

STEP = 1e-6  # central differences: error of order STEP² from curvature and 1e-16/STEP from rounding


def begin(solver: MSiLQR, start: Iterate) -> Run:
    """Return a run that stands at ``start``, all nodes shooting."""
    return Run(solver.functions, solver.options, start, solver.flags(True), None)


def somewhere(name: str) -> Run:
    """Return a run of a problem at a random iterate."""
    return at_random(PROBLEMS[name]())


def at_random(problem: Problem) -> Run:
    """Return a run at a random iterate, with random relaxations, multipliers and penalties; nothing is zero there."""
    rng = np.random.default_rng(0)
    solver = MSiLQR(compile_problem(problem))
    phases = solver.problem.phases
    tangents = [rng.normal(scale=0.1, size=(p.num_stages + 1, p.mode.state.ndx)) for p in phases]
    states = [p.mode.state.np_plus(p.guess_states, dx) for p, dx in zip(phases, tangents, strict=True)]
    controls = [p.guess_controls + rng.normal(size=p.guess_controls.shape) for p in phases]
    run = begin(solver, Iterate(states, controls))
    run.outer.weight = 0.3
    for dual in run.outer.duals:
        for key in ("relaxation", "end_relaxation", "penalty", "end_penalty"):
            setattr(dual, key, rng.uniform(0.5, 2.0, size=getattr(dual, key).shape))
        for key in ("multiplier", "end_multiplier"):
            setattr(dual, key, rng.normal(size=getattr(dual, key).shape))
    return run


def moved(run: Run, phase: int, node: int, dx: np.ndarray | None, du: np.ndarray | None) -> Iterate:
    """Return the run's iterate with one state or control moved."""
    x, u = [a.copy() for a in run.current.iterate.states], [a.copy() for a in run.current.iterate.controls]
    if dx is not None:
        x[phase][node] = run.problem.phases[phase].mode.state.np_plus(x[phase][node], dx)
    if du is not None:
        u[phase][node] = u[phase][node] + du
    return Iterate(x, u)


def nodes(run: Run) -> list[tuple[int, int]]:
    """Return a few (phase, node): the first, one inside, and the last two of every phase."""
    ends = [p.num_stages for p in run.problem.phases]
    return [(i, k) for i, n in enumerate(ends) for k in sorted({0, n // 2, n - 1, n})]


@pytest.mark.parametrize("name", PROBLEMS)
def test_gradient_of_the_augmented_lagrangian_matches_finite_differences(name: str) -> None:
    run = somewhere(name)
    models: list[LqPhase] = run.linearise()

    def slope(phase: int, node: int, dx: np.ndarray | None, du: np.ndarray | None) -> float:
        values = []
        for sign in (1, -1):
            step = [None if d is None else sign * STEP * d for d in (dx, du)]
            values.append(run.augmented(run.evaluate(moved(run, phase, node, *step))))
        return (values[0] - values[1]) / (2 * STEP)

    for i, k in nodes(run):
        n, ndx, nu = models[i].B.shape
        gradient = models[i].end_x if k == n else models[i].l_x[k]
        found = [slope(i, k, e, None) for e in np.eye(ndx)]
        np.testing.assert_allclose(gradient, found, rtol=1e-5, atol=1e-6 * (1 + np.max(np.abs(gradient))))
        if k < n:
            found = [slope(i, k, None, e) for e in np.eye(nu)]
            np.testing.assert_allclose(models[i].l_u[k], found, rtol=1e-5, atol=1e-6 * (1 + np.max(np.abs(found))))


def test_gradient_of_rows_of_the_implicit_variables_matches_finite_differences() -> None:
    """Equality, inequality and cost of the rope's tension, which is solved for: all change with state and control."""
    plain = rope()
    pull = equality(lambda s: s.tension - 2.0 * s.force[0], name="pull", unit="N")
    run = at_random(
        Problem(plain.motion, plain.schedule, plain.objective, plain.constraints + pull, initial=plain.initial)
    )
    run.outer.duals[1].shift = np.random.default_rng(1).uniform(0.1, 0.5, size=run.outer.duals[1].shift.shape)
    model, k = run.linearise()[1], 7
    assert np.abs(run.current.values[1].z[k, 2]) > 1.0  # the tension of the taut rope [N]
    for dx, du, gradient in ((np.eye(4), [None] * 4, model.l_x[k]), ([None] * 2, np.eye(2), model.l_u[k])):
        for a, b, expected in zip(dx, du, gradient, strict=True):
            ends = []
            for sign in (1, -1):
                step = [None if d is None else sign * STEP * d for d in (a, b)]
                ends.append(run.augmented(run.evaluate(moved(run, 1, k, *step))))
            assert (ends[0] - ends[1]) / (2 * STEP) == pytest.approx(expected, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("name", PROBLEMS)
def test_dynamics_and_reset_jacobians_match_finite_differences(name: str) -> None:
    """A, B and P are derivatives of the defects as they stand, so they hold at defects that are not zero."""
    run = somewhere(name)
    models: list[LqPhase] = run.linearise()

    def slopes(phase: int, node: int, row: tuple[int, int], dx: np.ndarray | None, du: np.ndarray | None) -> np.ndarray:
        found = []
        for sign in (1, -1):
            step = [None if d is None else sign * STEP * d for d in (dx, du)]
            found.append(run.evaluate(moved(run, phase, node, *step)).defects[row[0]][row[1]])
        return (found[0] - found[1]) / (2 * STEP)

    for i, k in nodes(run):
        n, ndx, nu = models[i].B.shape
        if k < n:
            A = np.array([slopes(i, k, (i, k + 1), e, None) for e in np.eye(ndx)]).T
            np.testing.assert_allclose(models[i].A[k], A, atol=1e-6)
            B = np.array([slopes(i, k, (i, k + 1), None, e) for e in np.eye(nu)]).T
            np.testing.assert_allclose(models[i].B[k], B, atol=1e-6)
        elif models[i].P is not None:
            P = np.array([slopes(i, k, (i + 1, 0), e, None) for e in np.eye(ndx)]).T
            np.testing.assert_allclose(models[i].P, P, atol=1e-6)


def test_jacobian_of_a_reset_that_turns_matches_finite_differences_at_a_large_defect() -> None:
    run = at_random(tumbling())
    model, found = run.linearise()[0], []
    assert np.linalg.norm(run.current.defects[1][0][:3]) > 0.5  # [rad], so that the difference bends
    for e in np.eye(6):
        ends = [run.evaluate(moved(run, 0, 4, sign * STEP * e, None)).defects[1][0] for sign in (1, -1)]
        found.append((ends[0] - ends[1]) / (2 * STEP))
    np.testing.assert_allclose(model.P, np.array(found).T, atol=1e-6)


@pytest.mark.parametrize("name", PROBLEMS)
def test_defects_vanish_on_a_simulated_trajectory(name: str) -> None:
    run = somewhere(name)
    states, x = [], run.problem.initial
    for i, (phase, u) in enumerate(zip(run.problem.phases, run.current.iterate.controls, strict=True)):
        rows = [x]
        rows += [x := run.functions.step(i, k, x, u[k]) for k in range(phase.num_stages)]
        states.append(np.array(rows))
        if phase.transition is not None:
            x = run.functions.reset(i, x)
    assert run.evaluate(Iterate(states, run.current.iterate.controls)).max_defect < 1e-12


def test_defect_is_what_the_step_gives_minus_what_is_there() -> None:
    run = somewhere("rope")
    x, u, d = run.current.iterate.states, run.current.iterate.controls, run.current.defects
    np.testing.assert_allclose(d[0][0], run.problem.initial - x[0][0])
    np.testing.assert_allclose(d[0][5], run.functions.step(0, 4, x[0][4], u[0][4]) - x[0][5])
    np.testing.assert_allclose(d[1][0], run.functions.reset(0, x[0][-1]) - x[1][0])


def test_masked_rows_count_for_nothing() -> None:
    run = somewhere("rope")
    before = run.augmented(run.current)
    (group,) = {p.mode.rows["stage_g"] for p in run.problem.phases}
    tension = [j for j, row in enumerate(group) if run.problem.terms[row.term].name == "tension"]
    assert np.all(run.problem.phases[1].g_mask[:, tension] == 1)
    weights = [
        p.weight[:, [j for j, r in enumerate(p.mode.rows["stage_residual"]) if r.unit == "N"]]
        for p in run.problem.phases
    ]
    assert np.all(weights[0][:, -1] == 0)  # the tension's cost is masked while the rope is slack
    assert np.all(weights[1][:, -1] > 0)
    run.outer.duals[0].end_multiplier = (
        run.outer.duals[0].end_multiplier + 1.0
    )  # the length counts where the rope tightens
    run.outer.duals[1].end_multiplier = run.outer.duals[1].end_multiplier + 1.0  # and nowhere else
    change = run.current.values[0].end_h.item()
    assert run.augmented(run.current) - before == pytest.approx(change)


def test_hessian_is_that_of_gauss_and_newton() -> None:
    run = somewhere("bouncing ball")
    model, (phase, _) = run.linearise()[0], run.problem.phases
    g, delta = run.current.values[0].g, run.outer.duals[0].relaxation
    # cost ½ 1.0 u², barrier rows u + 3 and 3 − u, each times dt
    expected = phase.dt * (1.0 + run.outer.weight * np.sum(barrier.curvature(g, delta), axis=1))
    np.testing.assert_allclose(model.l_uu[:, 0, 0], expected)
    end = model.end_xx
    np.testing.assert_allclose(end, run.outer.duals[0].end_penalty.item() * np.diag([1.0, 0.0]))  # σ ∇h ∇hᵀ, h = z


def test_linear_quadratic_model_of_a_linear_quadratic_problem_is_the_same_everywhere() -> None:
    solver, models = MSiLQR(compile_problem(linear_quadratic())), []
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        guess = [
            [a + rng.normal(size=a.shape) for a in table]
            for table in zip(*((p.guess_states, p.guess_controls) for p in solver.problem.phases), strict=True)
        ]
        models.append(begin(solver, Iterate(*guess)).linearise())
    for a, b in pairwise(models):
        for p, q in zip(a, b, strict=True):
            for name in ("A", "B", "l_xx", "l_ux", "l_uu", "end_xx", "P"):
                if p.P is not None or name != "P":
                    np.testing.assert_allclose(getattr(p, name), getattr(q, name), atol=1e-12)
