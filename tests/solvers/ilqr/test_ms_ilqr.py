"""MS-iLQR on small problems: exact where a closed form exists, and as good as Ipopt elsewhere."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import SolverError
from piaffe.ocp import CompiledProblem, compile_problem
from piaffe.solvers import MSiLQR, Options, Record, Solution, Status
from piaffe.solvers.ilqr import Backend

from ...problems import PROBLEMS, bouncing_ball, linear_quadratic, rope, swing_up
from .dense import stack_problem
from .referee import Verdict, referee

ACCURATE = Options(barrier_gap=1e-5, max_equality=1e-6, max_inequality=1e-6)
PRECISE = Options(barrier_gap=1e-6, max_equality=1e-7, max_inequality=1e-7, cost_tolerance=1e-9)


@cache
def compiled(name: str) -> CompiledProblem:
    return compile_problem(PROBLEMS[name]())


@cache
def solved(name: str) -> Solution:
    return MSiLQR(compiled(name), ACCURATE).solve()


@cache
def judged(name: str) -> Verdict:
    return referee(compiled(name))


# ---- linear-quadratic: one iteration, exact


@pytest.fixture(scope="module")
def lq() -> CompiledProblem:
    return compile_problem(linear_quadratic())


@pytest.fixture(scope="module")
def lq_solution(lq: CompiledProblem) -> Solution:
    return MSiLQR(lq).solve()


def test_linear_quadratic_problem_with_resets_takes_one_step(lq: CompiledProblem, lq_solution: Solution) -> None:
    stack, places = stack_problem(lq)
    w = stack.solve()
    assert lq_solution.converged
    assert lq_solution.iterations == 1
    assert lq_solution.history[0].step_size == 1.0
    assert lq_solution.history[0].cost == pytest.approx(stack.cost(w), rel=1e-12)
    for phase, x, u in zip(lq_solution.trajectory.phases, *places.split(w), strict=True):
        np.testing.assert_allclose(phase.states, x, atol=1e-10)
        np.testing.assert_allclose(phase.controls, u, atol=1e-10)


def test_phases_of_a_problem_may_differ_in_size(lq_solution: Solution) -> None:
    sizes = [(p.states.shape, p.controls.shape) for p in lq_solution.trajectory.phases]
    assert sizes == [((6, 4), (5, 2)), ((9, 3), (8, 1)), ((4, 2), (3, 0))]
    assert [p.feedback.shape for p in lq_solution.phases] == [(5, 2, 4), (8, 1, 3), (3, 0, 2)]


def test_expected_change_of_a_linear_quadratic_problem_is_exact(lq: CompiledProblem, lq_solution: Solution) -> None:
    start = MSiLQR(lq, Options(time_limit_s=1e-9)).solve()
    assert start.iterations == 0
    assert lq_solution.history[0].expected == pytest.approx(start.cost - lq_solution.cost, rel=1e-12)


def test_value_function_predicts_the_optimal_cost_of_another_start(lq: CompiledProblem, lq_solution: Solution) -> None:
    rng, first = np.random.default_rng(0), lq_solution.phases[0]
    for deviation in rng.normal(size=(3, 4)):
        other = MSiLQR(replace(lq, initial=lq.initial + deviation)).solve()  # replace: the targets stay where they are
        predicted = first.V_x[0] @ deviation + 0.5 * deviation @ first.V_xx[0] @ deviation
        assert other.cost - lq_solution.cost == pytest.approx(predicted, rel=1e-9)


def test_policy_is_optimal_from_another_start(lq: CompiledProblem, lq_solution: Solution) -> None:
    x = lq.initial + np.array([0.3, -0.2, 0.5, 0.1])
    best = MSiLQR(replace(lq, initial=x)).solve()
    for phase, plan, policy, expected in zip(
        lq.phases, lq_solution.trajectory.phases, lq_solution.phases, best.trajectory.phases, strict=True
    ):
        for k in range(phase.num_stages):
            u = plan.controls[k] + policy.feedforward[k] + policy.feedback[k] @ (x - plan.states[k])
            np.testing.assert_allclose(u, expected.controls[k], atol=1e-9)
            x = phase.mode.functions["stage"](x, u, [], phase.p[k])[0].full().ravel()
        if phase.transition is not None:
            x = phase.transition.functions["reset"](x, [], phase.p_transition).full().ravel()


# ---- against Ipopt


@pytest.mark.parametrize("name", PROBLEMS)
def test_solution_meets_every_tolerance(name: str) -> None:
    solution = solved(name)
    assert solution.status is Status.CONVERGED, solution.explain()
    assert solution.max_defect <= ACCURATE.max_defect
    assert solution.max_equality <= ACCURATE.max_equality
    assert solution.max_inequality <= ACCURATE.max_inequality
    assert solution.iterations <= 100


@pytest.mark.parametrize("name", PROBLEMS)
def test_very_tight_tolerances_are_met_too(name: str) -> None:
    solution = MSiLQR(compiled(name), PRECISE).solve()
    assert solution.status is Status.CONVERGED, solution.explain()
    assert solution.cost == pytest.approx(judged(name).cost, rel=1e-5)


@pytest.mark.parametrize("name", PROBLEMS)
def test_cost_without_barrier_agrees_with_ipopt(name: str) -> None:
    assert solved(name).cost == pytest.approx(judged(name).cost, rel=1e-4)


@pytest.mark.parametrize("name", PROBLEMS)
def test_trajectory_agrees_with_ipopt(name: str) -> None:
    for phase, x, u in zip(solved(name).trajectory.phases, judged(name).states, judged(name).controls, strict=True):
        np.testing.assert_allclose(phase.states, x, atol=0.02)
        np.testing.assert_allclose(phase.controls, u, atol=0.02 * max(1.0, float(np.max(np.abs(u)))))


@pytest.mark.parametrize("name", ["bouncing ball", "swing up", "flying body", "hopper", "rope"])
def test_limits_of_the_problem_are_active(name: str) -> None:
    # a referee that never touches a limit would judge nothing
    multipliers = [np.max(p.multipliers["inequality"], initial=0.0) for p in solved(name).phases]
    assert max(multipliers) > 0.01 * (1 + solved(name).cost)


def pushes(solution: Solution) -> float:
    """Return the sum of all multipliers of inequalities: how much cost a violation saves."""
    parts = zip(solution.trajectory.phases, solution.phases, strict=True)
    return sum(float(np.sum(np.diff(t.times)[:, None] * p.multipliers["inequality"])) for t, p in parts)


def test_default_options_come_as_close_as_they_promise() -> None:
    for name in PROBLEMS:
        solution = MSiLQR(compiled(name)).solve()
        assert solution.converged
        allowed = Options().barrier_gap * (1 + judged(name).cost) + Options().max_inequality * pushes(solution)
        assert abs(solution.cost - judged(name).cost) <= allowed


def test_barrier_of_limits_that_are_never_reached_leaves_no_gap() -> None:
    problem = compile_problem(rope(limit=6.0))
    assert MSiLQR(problem, ACCURATE).solve().cost == pytest.approx(referee(problem).cost, rel=1e-4)


def test_ball_agrees_with_its_own_equations() -> None:
    """The ball once more by hand, without the compiler: x⁺ = x + dt f(x, u), ½ Σ dt u², 1000 (z − 1.1)² at the end."""
    import casadi as cs

    opti, dt = cs.Opti(), 0.025
    z, v, u = opti.variable(36), opti.variable(36), opti.variable(34)  # 18 + 16 steps, one node twice
    opti.subject_to(z[0] == 1)
    opti.subject_to(v[0] == 0)
    for k in range(34):
        a, b = (k, k + 1) if k < 18 else (k + 1, k + 2)
        opti.subject_to(z[b] == z[a] + dt * v[a])
        opti.subject_to(v[b] == v[a] + dt * (u[k] - 9.81))
    opti.subject_to(z[18] == 0)
    opti.subject_to(z[19] == z[18])
    opti.subject_to(v[19] == -0.8 * v[18])
    opti.subject_to(opti.bounded(-3, u, 3))
    opti.minimize(0.5 * dt * cs.sumsqr(u) + 1000 * (z[35] - 1.1) ** 2)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-10})
    best = opti.solve()
    assert solved("bouncing ball").cost == pytest.approx(float(best.value(opti.f)), rel=1e-4)
    impact = solved("bouncing ball").trajectory.phases[1].states[0]
    np.testing.assert_allclose(impact, [0.0, float(best.value(v[19]))], atol=1e-3)


@pytest.mark.parametrize("name", ["swing up", "hopper", "rope"])
def test_value_gradient_matches_optima_of_ipopt_from_nearby_starts(name: str) -> None:
    problem, step = compiled(name), 1e-4
    gradient = []
    for e in np.eye(len(problem.initial)):
        costs = [referee(replace(problem, initial=problem.initial + s * e)).cost for s in (step, -step)]
        gradient.append((costs[0] - costs[1]) / (2 * step))
    # barrier and penalties are part of V: it is the problem's own as far as their weights have vanished
    options = replace(ACCURATE, cost_tolerance=1e-9) if name == "hopper" else PRECISE
    found = MSiLQR(problem, options).solve().phases[0].V_x[0]
    np.testing.assert_allclose(found, gradient, atol=2e-3 * float(np.max(np.abs(gradient))))


# ---- the run


def test_warm_start_from_a_solution_is_done_at_once() -> None:
    for name in PROBLEMS:
        again = MSiLQR(compiled(name), ACCURATE).solve(solved(name))
        assert again.converged
        assert again.iterations <= 1
        assert again.cost == pytest.approx(solved(name).cost, rel=1e-5)


def test_warm_start_with_defaults_is_done_at_once() -> None:
    solver = MSiLQR(compiled("swing up"))
    assert solver.solve(solver.solve()).iterations <= 1


@pytest.mark.parametrize("name", ["bouncing ball", "flying body", "rope"])
def test_resumed_solve_is_as_accurate_as_one_in_a_run(name: str) -> None:
    for iterations in (1, 6, 11, 16):
        part = MSiLQR(compiled(name), Options(max_iterations=iterations)).solve()
        rest = MSiLQR(compiled(name)).solve(part)
        assert rest.converged
        assert rest.cost == pytest.approx(judged(name).cost, rel=2e-4)


def test_warm_start_of_a_changed_problem_is_shorter_than_a_cold_one() -> None:
    problem = swing_up()
    nearby = MSiLQR(problem.with_initial(problem.initial + 0.02))
    cold, warm = nearby.solve(), nearby.solve(MSiLQR(problem).solve())
    assert cold.converged
    assert warm.converged
    assert warm.iterations < cold.iterations
    assert warm.cost == pytest.approx(cold.cost, rel=1e-3)


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_a_start_that_was_no_solution_does_not_end_the_barrier(backend: Backend) -> None:
    """A solve that stopped at its first sub-problem's solution has not shown by how much the barrier bends it."""
    ball = ocp.Model(
        "ball", state={"z": 1, "vz": 1}, control={"thrust": 1},
        modes={"fall": lambda s: {"z": s.vz, "vz": s.thrust - 9.81}},
    )  # fmt: skip
    hover = ocp.Problem(
        ocp.Motion(ocp.Phase("hover", "fall", 0.5)), ball.until_end(dt=0.05),
        ocp.Objective(ocp.track("thrust", 0.1, to=9.81), ocp.track("z", 20.0, to=0.3, at="end")),
        ocp.Constraints(ocp.inequality(lambda s: s.z, lower=0.0, name="floor", unit="m")), initial=[0.2, 0.0],
    )  # fmt: skip
    problem, patient = compile_problem(hover), replace(ACCURATE, max_inner=100, barrier_weight=10.0, cost_scale=1.0)
    weights = [record.barrier_weight for record in MSiLQR(problem, patient, backend=backend).solve().history]
    first = replace(patient, max_iterations=weights.count(weights[0]))
    part = MSiLQR(problem, first, backend=backend).solve()
    assert part.status is Status.ITERATION_LIMIT
    assert part.max_inequality <= ACCURATE.max_inequality
    best = referee(problem).cost
    assert part.cost > best + 1e-3 * (1 + best)
    rest = MSiLQR(problem, patient, backend=backend).solve(replace(part, search=None))
    assert rest.converged
    assert rest.cost == pytest.approx(best, abs=1e-4 * (1 + best))


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_a_start_may_have_either_sign_of_each_quaternion(backend: Backend) -> None:
    """q and −q are one attitude: turned over at every other node, a solution is still one, without a defect."""
    found = MSiLQR(compiled("flying body"), ACCURATE, backend=backend).solve()
    (phase,) = found.trajectory.phases
    states = phase.states.copy()
    states[1::2, 3:7] *= -1
    turned = replace(found, trajectory=replace(found.trajectory, phases=(replace(phase, states=states),)))
    again = MSiLQR(compiled("flying body"), ACCURATE, backend=backend).solve(turned)
    assert (again.status, again.iterations) == (Status.CONVERGED, 0)
    assert again.cost == pytest.approx(found.cost, rel=1e-12)
    assert again.max_defect == pytest.approx(found.max_defect, abs=1e-12)


def test_warm_start_of_other_phases_is_refused() -> None:
    with pytest.raises(SolverError, match=r"is of other models - got \['cart pole'\], expected 'ball' with"):
        MSiLQR(compiled("bouncing ball")).solve(solved("swing up"))


@pytest.mark.parametrize("backend", ["native", "numpy"])
@pytest.mark.parametrize("name", ["bouncing ball", "hopper", "rope"])
def test_rows_that_do_not_hold_have_no_multipliers(name: str, backend: Backend) -> None:
    """An equality that holds at the end of one phase alone is a masked row of the others."""
    solution, held = MSiLQR(compiled(name), ACCURATE, backend=backend).solve(), 0
    for phase, found in zip(compiled(name).phases, solution.phases, strict=True):
        assert not np.any(found.multipliers["equality"][phase.h_mask == 0])
        assert not np.any(found.multipliers["end_equality"][phase.end_h_mask == 0])
        assert not np.any(found.multipliers["inequality"][phase.g_mask == 0])
        assert not np.any(found.multipliers["end_inequality"][phase.end_g_mask == 0])
        assert np.all(found.multipliers["end_equality"][phase.end_h_mask == 1])
        held += int(phase.end_h_mask.sum())
    assert 0 < held < sum(phase.end_h_mask.size for phase in compiled(name).phases)


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_an_inequality_at_the_end_is_seen_and_met(backend: Backend) -> None:
    ball = ocp.Model(
        "ball", state={"z": 1, "vz": 1}, control={"thrust": 1},
        modes={"fall": lambda s: {"z": s.vz, "vz": s.thrust - 9.81}},
    )  # fmt: skip
    problem = compile_problem(
        ocp.Problem(
            ocp.Motion(ocp.Phase("rise", "fall", 0.5)), ball.until_end(dt=0.05),
            ocp.Objective(ocp.regularize("thrust", 1.0)),
            ocp.Constraints(ocp.inequality(lambda s: s.z, lower=1.5, at="end", name="high", unit="m", scale=0.5)),
            initial=[1.0, 0.0],
        )
    )  # fmt: skip
    begun = MSiLQR(problem, replace(ACCURATE, max_iterations=1), backend=backend).solve()
    missed = 1.5 - begun.trajectory.phases[-1].states[-1, 0]
    assert missed > 0.01
    assert begun.max_inequality == pytest.approx(missed / 0.5)
    assert begun.history[-1].max_inequality == pytest.approx(missed / 0.5)
    done = MSiLQR(problem, ACCURATE, backend=backend).solve()
    assert done.converged
    assert done.trajectory.phases[-1].states[-1, 0] == pytest.approx(1.5, abs=1e-3)
    assert done.cost == pytest.approx(referee(problem).cost, rel=1e-4)


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_defects_are_closed_where_they_cost_next_to_nothing(backend: Backend) -> None:
    """A free fall whose guess floats: no cost decreases by much, and yet the states are to be those of the fall."""
    ball = ocp.Model(
        "ball", state={"z": 1, "vz": 1}, control={"thrust": 1},
        modes={"fall": lambda s: {"z": s.vz, "vz": s.thrust - 9.81}},
    )  # fmt: skip
    fall = ocp.Problem(
        ocp.Motion(ocp.Phase("fall", "fall", 0.5, {"z": 1.0})), ball.until_end(dt=0.05),
        ocp.Objective(ocp.regularize("thrust", 1e-7)), initial=[1.0, 0.0],
    )  # fmt: skip
    solution = MSiLQR(fall, backend=backend).solve()
    z, v = 1.0, 0.0
    for _ in range(10):
        z, v = z + 0.05 * v, v - 0.05 * 9.81
    assert solution.converged
    np.testing.assert_allclose(solution.trajectory.phases[0].states[-1], [z, v], atol=1e-4)


# ---- single shooting and everything between


@pytest.mark.parametrize("name", ["bouncing ball", "flying body", "rope"])
def test_single_shooting_finds_the_same(name: str) -> None:
    solution = MSiLQR(compiled(name), ACCURATE).solve(shooting=False)
    assert solution.converged
    assert all(record.max_defect < 1e-9 for record in solution.history)  # rolled out: there is nothing to close
    assert solution.cost == pytest.approx(judged(name).cost, rel=1e-4)


def test_single_shooting_of_a_linear_quadratic_problem_takes_one_step(
    lq: CompiledProblem, lq_solution: Solution
) -> None:
    solution = MSiLQR(lq).solve(shooting=False)
    assert solution.iterations == 1
    assert solution.cost == pytest.approx(lq_solution.cost, rel=1e-12)


def test_some_nodes_may_shoot() -> None:
    flags = [np.arange(p.num_stages + 1) % 5 == 0 for p in compiled("rope").phases]
    solution = MSiLQR(compiled("rope"), ACCURATE).solve(shooting=flags)
    assert solution.cost == pytest.approx(judged("rope").cost, rel=1e-4)
    part = MSiLQR(compiled("rope"), Options(max_iterations=1)).solve(shooting=flags)
    for phase, flag in zip(part.phases, flags, strict=True):
        assert np.max(np.abs(phase.defects[~flag])) < 1e-12
    assert part.max_defect > 1e-6


def test_flags_of_another_shape_are_refused() -> None:
    with pytest.raises(
        SolverError, match=r"shooting: flags do not fit the phases - got shapes \[\(3,\)\], expected \[\(31,\)\]"
    ):
        MSiLQR(compiled("swing up")).solve(shooting=[np.ones(3)])


def test_two_solves_are_equal_to_the_last_bit() -> None:
    first, second = (MSiLQR(PROBLEMS["hopper"](), ACCURATE).solve() for _ in range(2))
    assert [(r.cost, r.merit, r.step_size) for r in first.history] == [
        (r.cost, r.merit, r.step_size) for r in second.history
    ]
    for a, b in zip(first.trajectory.phases, second.trajectory.phases, strict=True):
        np.testing.assert_array_equal(a.states, b.states)
        np.testing.assert_array_equal(a.controls, b.controls)
    for p, q in zip(first.phases, second.phases, strict=True):
        np.testing.assert_array_equal(p.feedback, q.feedback)


def test_solver_does_not_change_its_problem() -> None:
    problem = compile_problem(bouncing_ball())
    kept = [(p.guess_states.copy(), p.guess_controls.copy(), p.p.copy()) for p in problem.phases]
    MSiLQR(problem).solve()
    for phase, (x, u, p) in zip(problem.phases, kept, strict=True):
        np.testing.assert_array_equal(phase.guess_states, x)
        np.testing.assert_array_equal(phase.guess_controls, u)
        np.testing.assert_array_equal(phase.p, p)


def test_progress_sees_every_record() -> None:
    seen: list[Record] = []
    solution = MSiLQR(compiled("bouncing ball")).solve(progress=seen.append)
    assert tuple(seen) == solution.history
    assert [r.iteration for r in seen] == list(range(1, len(seen) + 1))
    assert all(a.wall_s <= b.wall_s for a, b in pairwise(seen))


def test_merit_falls_as_long_as_its_weights_stay() -> None:
    history = solved("swing up").history
    falls = [
        b.cost <= a.cost + 1e-9
        for a, b in pairwise(history)
        if a.barrier_weight == b.barrier_weight and max(a.max_defect, b.max_defect) < 1e-9
    ]
    assert sum(falls) >= 0.8 * len(falls)


# ---- parameters: nothing is rebuilt


def test_another_value_of_a_parameter_lowers_nothing_again() -> None:
    problem = bouncing_ball(restitution=ocp.parameter("restitution", 0.8))
    first = MSiLQR(problem)
    other = MSiLQR(problem.with_parameters(restitution=0.9))
    assert first.problem.lowered > 0
    assert other.problem.lowered == 0
    high, low = other.solve(), first.solve()
    assert high.trajectory.phases[1].states[0, 1] == pytest.approx(
        -0.9 * high.trajectory.phases[0].states[-1, 1], abs=1e-6
    )
    assert high.cost < low.cost  # a livelier ball needs less thrust
    assert low.cost == pytest.approx(solved("bouncing ball").cost, rel=1e-3)


def test_other_weights_limits_targets_and_timings_lower_nothing_again() -> None:
    def fall(s):
        return {"z": s.vz, "vz": s.thrust - 9.81}

    def thrust(s):
        return s.thrust

    ball = ocp.Model("ball", state={"z": 1, "vz": 1}, control={"thrust": 1}, modes={"fall": fall})

    def make(weight: float, limit: float, height: float, duration: float) -> ocp.Problem:
        return ocp.Problem(
            ocp.Motion(ocp.Phase("hover", "fall", duration, {"z": height})),
            ball.until_end(dt=0.05),
            ocp.Objective(ocp.track("z", weight), ocp.regularize("thrust", 0.003)),
            ocp.Constraints(ocp.inequality(thrust, upper=limit, name="thrust")),
            initial=[0.0, 0.0],
        )

    first, second = MSiLQR(make(1.0, 30.0, 0.5, 1.0)), MSiLQR(make(3.0, 6.0, 0.8, 0.6))
    assert second.problem.lowered == 0
    assert np.max(first.solve().controls) > 6.5
    assert np.max(second.solve().controls) == pytest.approx(6.0, abs=0.02)


@pytest.mark.parametrize("name", ["go2", "mini_cheetah"])
def test_first_steps_of_a_sixteenth_do_not_end_a_hop(name: str) -> None:
    robot = models.load(name)
    body, height, every = models.WholeBody(robot), robot.base_height("stand"), models.stance(roles="all")
    above = ocp.Keyframe(position=(0, 0, height), joints="stand")
    motion = ocp.Motion(
        ocp.Phase("push", every, 0.2, above), ocp.Phase("flight", models.stance(""), 0.2, above),
        ocp.Phase("land", every, 0.2, above),
    )  # fmt: skip
    objective = ocp.Objective(
        ocp.track("base.position", weight=(1, 1, 10)), ocp.track("base.orientation", weight=2.0),
        ocp.track("base.linear_velocity", weight=0.5), ocp.track("base.angular_velocity", weight=0.1),
        ocp.track("joints.position", weight=0.5), ocp.track("joints.velocity", weight=0.05),
        ocp.regularize("joints.torque", weight=0.02),
    )  # fmt: skip
    limits = ocp.Constraints(models.friction_cone(0.6), models.torque_limits(), models.foot_clearance())
    problem = ocp.Problem(motion, body.until_end(dt=0.01), objective, limits, initial=body.state(joints="stand"))
    solution = MSiLQR(problem).solve()
    assert solution.converged, solution.explain()
    assert any(record.step_size < 0.1 for record in solution.history)


# ---- options


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"max_defect": 0.0}, "max_defect is out of range - got 0.0, expected a positive number; increase"),
        ({"barrier_weight": -1.0}, "barrier_weight is out of range - got -1.0, expected a positive number"),
        ({"barrier_weight": float("nan")}, "barrier_weight is out of range - got nan"),
        ({"step_shrink": 1.5}, "step_shrink is out of range - got 1.5, expected below 1; lower it"),
        ({"armijo": 1.0}, "armijo is out of range - got 1.0, expected below 1"),
        ({"max_iterations": 0}, "max_iterations is out of range - got 0"),
        ({"time_limit_s": -2.0}, "time_limit_s is out of range - got -2.0"),
    ],
)
def test_options_are_checked(values: dict[str, float], message: str) -> None:
    with pytest.raises(SolverError, match=rf"options \(test_ms_ilqr.py:\d+\): {message}"):
        Options(**values)


def test_options_are_frozen_and_taken_by_name() -> None:
    with pytest.raises(AttributeError):
        Options().max_iterations = 3  # type: ignore[misc]
    with pytest.raises(TypeError):
        Options(3)  # type: ignore[misc]
    with pytest.raises(TypeError, match="max_iteration"):
        Options(max_iteration=3)  # type: ignore[call-arg]
