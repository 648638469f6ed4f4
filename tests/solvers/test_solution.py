"""Solutions: how a solve ends, what it says about it, and what a solution holds."""

import json
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import SolverError
from piaffe.ocp import PhaseTrajectory, compile_problem
from piaffe.solvers import MSiLQR, Options, PhaseSolution, Record, Solution, Status

from ..problems import PROBLEMS, bouncing_ball, flying_body, hopper, rope, swing_up


@pytest.fixture(scope="module")
def ball() -> Solution:
    return MSiLQR(bouncing_ball()).solve()


@pytest.fixture(scope="module")
def impossible() -> Solution:
    """A ball that cannot reach the ground in time with the thrust that it has."""
    return MSiLQR(bouncing_ball(limit=0.1), Options(max_iterations=60)).solve()


# ---- status


@pytest.mark.parametrize("status", Status)
def test_status_is_a_sentence(status: Status) -> None:
    assert status.advice == status.value
    assert status.advice[0].isupper()
    assert status.advice.endswith(".")
    assert len(status.advice.split()) >= 7


@pytest.mark.parametrize("status", [s for s in Status if s not in (Status.CONVERGED, Status.INTERRUPTED)])
def test_status_of_a_failure_advises(status: Status) -> None:
    words = ("raise", "see explain()", "relax", "check", "warm-start")
    assert any(word in status.advice for word in words)


def test_solution_is_converged_only_by_status(ball: Solution) -> None:
    assert ball.converged
    assert ball.raise_if_failed() is ball
    assert not replace(ball, status=Status.TIME_LIMIT).converged


def test_iteration_limit() -> None:
    solution = MSiLQR(swing_up(), Options(max_iterations=3)).solve()
    assert solution.status is Status.ITERATION_LIMIT
    assert solution.iterations == 3
    with pytest.raises(SolverError, match="iteration limit") as caught:
        solution.raise_if_failed()
    assert "After 3 iterations" in str(caught.value)


def test_time_limit_returns_what_there_is() -> None:
    solution = MSiLQR(swing_up(), Options(time_limit_s=1e-9)).solve()
    assert solution.status is Status.TIME_LIMIT
    assert solution.iterations == 0
    assert "Stopped at the time limit" in solution.explain()
    assert np.all(np.isfinite(solution.states))


def test_limit_of_iterations_can_be_resumed() -> None:
    problem = compile_problem(swing_up())
    part = MSiLQR(problem, Options(max_iterations=8)).solve()
    rest = MSiLQR(problem).solve(part)
    assert not part.converged
    assert rest.converged


def test_interrupted_solve_returns_its_iterate() -> None:
    def stop(record: Record) -> None:
        if record.iteration == 4:
            raise KeyboardInterrupt

    solution = MSiLQR(swing_up(), backend="numpy").solve(progress=stop)
    assert solution.status is Status.INTERRUPTED
    assert solution.iterations == 4
    assert solution.cost == solution.history[-1].cost
    assert solution.max_defect == solution.history[-1].max_defect


def test_interrupt_between_two_records_returns_the_last_whole_iterate(monkeypatch: pytest.MonkeyPatch) -> None:
    solver, calls = MSiLQR(swing_up(), backend="numpy"), []
    original = solver.functions.values

    def values(*arguments: object) -> object:
        calls.append(1)
        if len(calls) == 40:
            raise KeyboardInterrupt
        return original(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(solver.functions, "values", values)
    solution = solver.solve()
    assert solution.status is Status.INTERRUPTED
    assert solution.cost == solution.history[-1].cost


def test_errors_of_a_progress_callback_are_not_swallowed() -> None:
    def broken(record: Record) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        MSiLQR(swing_up()).solve(progress=broken)


def test_failed_line_search_leaves_the_iterate_and_regularises_more() -> None:
    # no step can be shorter than one, and a full step from the keyframes fails
    solution = MSiLQR(swing_up(), Options(max_iterations=3, min_step=0.99, armijo=0.999, corrections=1)).solve()
    failed = [(a, b) for a, b in pairwise(solution.history) if b.step_size == 0.0]
    assert failed
    for before, after in failed:
        assert (after.cost, after.max_defect) == (before.cost, before.max_defect)
        assert after.regularization > before.regularization


# ---- what cannot be met


def test_infeasible_problem_ends_without_an_exception(impossible: Solution) -> None:
    assert impossible.status in (Status.INFEASIBLE, Status.ITERATION_LIMIT, Status.LINE_SEARCH_FAILED)
    assert np.isfinite(impossible.cost)


@pytest.mark.parametrize("limit", [0.1, 0.5])
def test_ball_that_cannot_fall_fast_enough_is_infeasible(limit: float) -> None:
    solution = MSiLQR(bouncing_ball(limit=limit)).solve()
    assert solution.status is Status.INFEASIBLE
    assert solution.iterations < 100


def test_inequalities_that_exclude_each_other_are_infeasible() -> None:
    pole, push = swing_up(), ocp.inequality(lambda s: s.force, lower=14.0, name="push")
    problem = ocp.Problem(pole.motion, pole.schedule, pole.objective, pole.constraints + push, initial=np.zeros(4))
    solution = MSiLQR(problem, Options(max_iterations=300)).solve()
    assert solution.status is Status.INFEASIBLE
    assert "'push lower'" in solution.explain()
    assert "'force limit upper'" in solution.explain()


def test_explanation_names_the_rows_that_exclude_each_other(impossible: Solution) -> None:
    text = impossible.explain()
    assert impossible.status.advice in text
    assert "equality 'ground' (problems.py:" in text
    assert "inequality 'thrust limit lower' (problems.py:" in text
    assert "phase 'drop', node 18" in text
    assert "Relaxation with which all rows can hold" in text
    source = next(v.source for v in impossible.violations if v.name == "thrust limit lower")
    assert source.startswith("problems.py:")


def test_declared_place_is_the_line_of_the_constraint() -> None:
    here = ocp.inequality(lambda s: s.thrust, upper=-20.0, name="downward")  # this line
    problem = bouncing_ball()
    problem = ocp.Problem(
        problem.motion, problem.schedule, problem.objective, ocp.Constraints(here), initial=[1.0, 0.0]
    )
    solution = MSiLQR(problem, Options(max_iterations=1)).solve()
    (violation,) = (v for v in solution.violations if v.name.startswith("downward"))
    assert violation.source == str(here.source)
    assert violation.source.startswith("test_solution.py:")


# ---- accounts


@pytest.mark.parametrize("name", PROBLEMS)
def test_term_costs_sum_to_the_cost(name: str) -> None:
    solution = MSiLQR(PROBLEMS[name](), Options(max_iterations=4)).solve()
    assert sum(solution.term_costs.values()) == pytest.approx(solution.cost, rel=1e-12)
    assert all(value >= 0 for value in solution.term_costs.values())


def test_term_costs_are_those_of_the_declaration(ball: Solution) -> None:
    thrust = np.concatenate([p.controls[:, 0] for p in ball.trajectory.phases])
    height = ball.trajectory.phases[-1].states[-1, 0]
    assert set(ball.term_costs) == {"track z at end", "regularize thrust"}
    assert ball.term_costs["regularize thrust"] == pytest.approx(0.5 * 0.025 * np.sum(thrust**2))
    assert ball.term_costs["track z at end"] == pytest.approx(1000 * (height - 1.1) ** 2)


def test_violations_name_every_constraint_once_and_come_worst_first(impossible: Solution) -> None:
    names = [v.name for v in impossible.violations]
    assert sorted(n.removesuffix(" lower").removesuffix(" upper") for n in names) == ["ground", "thrust limit"]
    assert all(a.amount >= b.amount for a, b in pairwise(impossible.violations))
    thrust = np.concatenate([p.controls[:, 0] for p in impossible.trajectory.phases])
    worst = next(v for v in impossible.violations if v.kind == "inequality")
    assert worst.amount == pytest.approx(np.max(np.abs(thrust)) - 0.1)
    assert worst.amount == pytest.approx(impossible.max_inequality)
    assert worst.unit == "N"
    ground = next(v for v in impossible.violations if v.kind == "equality")
    assert ground.amount == pytest.approx(abs(impossible.trajectory.phases[0].states[-1, 0]))
    assert (ground.phase, ground.node) == ("drop", 18)


def test_violations_are_divided_by_the_declared_scale() -> None:
    low = rope()
    solution = MSiLQR(low, Options(max_iterations=1)).solve()
    amounts = {v.name: v.amount for v in solution.violations}
    tension = np.concatenate([next(iter(p.outputs.values()))[:, 0] for p in solution.trajectory.phases[1:]])
    worst = max(0.0, -float(np.min(tension)), float(np.max(tension)) - 60) / 10
    assert max(v for k, v in amounts.items() if k.startswith("tension")) == pytest.approx(worst, abs=1e-9)


def test_limits_are_recorded_as_declared(ball: Solution) -> None:
    limits = json.loads(json.dumps(list(ball.limits)))
    (limit,) = (x for x in limits if x["name"] == "thrust limit")
    assert (limit["lower"], limit["upper"], limit["unit"], limit["model"]) == ([-3.0], [3.0], "N", "ball")


def test_active_limits_have_multipliers_of_the_right_sign(ball: Solution) -> None:
    for phase, policy in zip(ball.trajectory.phases, ball.phases, strict=True):
        push = policy.multipliers["inequality"]
        assert np.all(push >= 0)
        # dt (R u − λ_lower + λ_upper) + Bᵀ V_x = 0, and Q_u is that sum
        np.testing.assert_allclose(policy.Q_u, 0.0, atol=1e-3)
        saturated = np.abs(np.abs(phase.controls[:, 0]) - 3.0) < 1e-3
        assert np.all(np.max(push[saturated], axis=1, initial=0.0) > 0.01)


# ---- policy and expansions


@pytest.mark.parametrize("make", [swing_up, flying_body, hopper, rope])
def test_expansions_agree_with_the_policy(make) -> None:
    solution = MSiLQR(make()).solve()
    for policy in solution.phases:
        for k in range(len(policy.feedforward)):
            Q_uu, Q_ux = policy.Q_uu[k], policy.Q_ux[k]
            np.testing.assert_allclose(Q_uu, Q_uu.T)
            assert np.all(np.linalg.eigvalsh(Q_uu) > 0)
            np.testing.assert_allclose(Q_uu @ policy.feedforward[k], -policy.Q_u[k], atol=1e-8)
            np.testing.assert_allclose(Q_uu @ policy.feedback[k], -Q_ux, atol=1e-7 * np.max(np.abs(Q_ux)) + 1e-9)
            V_xx = policy.Q_xx[k] + Q_ux.T @ policy.feedback[k]
            np.testing.assert_allclose(policy.V_xx[k], V_xx, atol=1e-8 * np.max(np.abs(V_xx)) + 1e-9)


@pytest.mark.parametrize("make", [swing_up, flying_body])
def test_feedback_keeps_a_disturbed_start_on_its_way(make) -> None:
    problem = compile_problem(make())
    solution = MSiLQR(problem).solve()
    (phase,), (plan,), (policy,) = problem.phases, solution.trajectory.phases, solution.phases
    nudge = np.random.default_rng(0).normal(scale=0.01, size=phase.mode.state.ndx)
    ends = []
    for gain in (0.0, 1.0):
        x = phase.mode.state.np_plus(plan.states[0], nudge)
        for k in range(phase.num_stages):
            u = plan.controls[k] + gain * policy.feedback[k] @ phase.mode.state.np_minus(x, plan.states[k])
            x = phase.mode.state.np_normalise(phase.mode.functions["stage"](x, u, [], phase.p[k])[0].full().ravel())
        ends.append(float(np.linalg.norm(phase.mode.state.np_minus(x, plan.states[-1]))))
    assert ends[1] < 0.5 * ends[0]


def test_rotations_stay_unit_quaternions() -> None:
    for iterations in (2, 100):
        (phase,) = MSiLQR(flying_body(), Options(max_iterations=iterations)).solve().trajectory.phases
        np.testing.assert_allclose(np.linalg.norm(phase.states[:, 3:7], axis=1), 1.0, atol=1e-12)


def test_shapes_are_those_documented() -> None:
    solution = MSiLQR(flying_body(), Options(max_iterations=2)).solve()
    (phase,), (policy,) = solution.trajectory.phases, solution.phases
    n, nx, ndx, nu = 20, 13, 12, 6
    assert (phase.times.shape, phase.states.shape, phase.controls.shape) == ((n + 1,), (n + 1, nx), (n, nu))
    shapes = {f.name: getattr(policy, f.name).shape for f in fields(PhaseSolution) if f.name != "multipliers"}
    assert shapes == {
        "feedforward": (n, nu), "feedback": (n, nu, ndx), "V_x": (n + 1, ndx), "V_xx": (n + 1, ndx, ndx),
        "Q_x": (n, ndx), "Q_u": (n, nu), "Q_xx": (n, ndx, ndx), "Q_ux": (n, nu, ndx), "Q_uu": (n, nu, nu),
        "defects": (n + 1, ndx), "target_states": (n + 1, nx),
    }  # fmt: skip
    assert policy.multipliers["equality"].shape == (n, 0)
    assert policy.multipliers["end_equality"].shape == (6,)
    assert policy.multipliers["inequality"].shape == (n, 1)


def test_outputs_are_recorded_per_stage() -> None:
    slack, taut = MSiLQR(rope()).solve().trajectory.phases
    ((quantity, tension),) = taut.outputs.items()
    assert (quantity.path, quantity.unit) == ("tension", "N")
    assert tension.shape == (30, 1)
    assert np.all(tension > 0)
    np.testing.assert_array_equal(next(iter(slack.outputs.values())), 0.0)


def test_history_ends_where_the_solution_is(ball: Solution) -> None:
    last = ball.history[-1]
    assert (last.cost, last.max_defect, last.max_equality, last.max_inequality) == pytest.approx(
        (ball.cost, ball.max_defect, ball.max_equality, ball.max_inequality), rel=1e-9, abs=1e-12
    )
    assert last.barrier_weight == ball.barrier_weight
    assert 0 < last.wall_s <= ball.wall_s


def test_summary_and_explanation_are_short_texts(ball: Solution, impossible: Solution) -> None:
    assert str(ball).startswith(f"CONVERGED: {ball.iterations} iterations")
    assert "regularize thrust" in str(ball)
    assert "Converged" in ball.explain()
    assert impossible.explain() in str(impossible)
    assert all(len(line) < 250 for line in str(impossible).splitlines())


def test_trajectory_of_a_solution_is_a_motion_again(ball: Solution) -> None:
    assert isinstance(ball.trajectory.phases[0], PhaseTrajectory)
    assert [p.name for p in ball.trajectory.phases] == ["drop", "rise"]
    assert ball.trajectory.duration == pytest.approx(0.85)
    again = ocp.Motion.from_trajectory(ball.trajectory)
    assert again.duration == pytest.approx(0.85)
