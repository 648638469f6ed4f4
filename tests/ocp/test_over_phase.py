"""Bounds that are functions of the time within a phase are numbers at each node."""

import pickle

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ProblemError, ShapeError
from piaffe.models import base, stance
from piaffe.ocp import ParameterKey
from piaffe.viz.curves import panels
from piaffe.viz.figure import draw
from tests.ocp.test_horizon import assert_same, on_path, quadruped, turning_jump

CART = ocp.Model("cart", state={"x": 1, "v": 1}, control={"push": 1}, modes={"roll": lambda s: {"x": s.v, "v": s.push}})


def place(s):
    return s.x


def push(s):
    return s.push


def ceiling(at):
    """A ceiling that comes down from 1 to 0.2 in each phase."""
    return 1.0 - 0.8 * at.share


def cart(*limits, phases=(("go", 0.5), ("stay", 0.3)), goal=1.0, dt=0.05, **more):
    """Push a cart to a place, under limits."""
    motion = ocp.Motion(*(ocp.Phase(name, "roll", duration) for name, duration in phases))
    objective = ocp.Objective(
        ocp.track("x", 10.0, to=goal), ocp.regularize("v", 0.01), ocp.regularize("push", 1e-3)
    )  # fmt: skip
    constraints = ocp.Constraints(*limits)
    return ocp.Problem(motion, CART.until_end(dt=dt), objective, constraints, initial=[0.0, 0.0], **more)


def bounds(compiled, side="upper", term=3):
    """Return the bounds of each phase's nodes, the last one included; infinite where there is none."""
    key = ParameterKey(side, term=term)
    found = []
    for phase in compiled.phases:
        p, slices = np.vstack([phase.p, phase.p_end]), phase.mode.layout.slices
        far = np.inf if side == "upper" else -np.inf
        found.append(np.where(p[:, slices[key.has_bound]] > 0, p[:, slices[key]], far))
    return found


# ---- numbers of nodes


def test_each_node_has_the_bound_of_its_time_in_the_phase():
    limit = ocp.inequality(place, upper=ocp.over_phase(lambda at: 1.0 - 2.0 * at.t), name="limit", unit="m")
    first, second = bounds(ocp.compile_problem(cart(limit)))
    np.testing.assert_allclose(first[:, 0], 1.0 - 2.0 * np.linspace(0, 0.5, 11), atol=1e-12)
    np.testing.assert_allclose(second[:, 0], 1.0 - 2.0 * np.linspace(0, 0.3, 7), atol=1e-12)


def test_a_function_knows_share_duration_phase_and_model():
    seen = []

    def upper(at):
        seen.append(at)
        return at.duration + at.share

    ocp.compile_problem(cart(ocp.inequality(place, upper=ocp.over_phase(upper), name="limit", unit="m")))
    assert {(at.phase, at.duration, at.model) for at in seen} == {("go", 0.5, CART), ("stay", 0.3, CART)}
    assert sorted({at.share for at in seen if at.phase == "go"}) == pytest.approx(np.linspace(0, 1, 11))
    assert all(0 <= at.t <= at.duration for at in seen)


def test_a_horizon_that_begins_within_a_phase_counts_from_the_phases_start():
    limit = ocp.inequality(place, upper=ocp.over_phase(lambda at: at.t), name="limit", unit="m")
    found = bounds(ocp.compile_problem(cart(limit), t0=0.2))
    np.testing.assert_allclose(found[0][:, 0], np.linspace(0.2, 0.5, 7), atol=1e-12)


def test_every_cycle_has_the_same_bounds_to_the_bit():
    limit = ocp.inequality(place, upper=ocp.over_phase(lambda at: at.t), name="limit", unit="m")
    motion = ocp.Motion(ocp.Phase("go", "roll", 0.7), cyclic=True)
    declared = ocp.Problem(
        motion.cycles(20), CART.until_end(dt=0.07), ocp.Objective(ocp.regularize("push"), ocp.track("x", to=0.0)),
        ocp.Constraints(limit), initial=[0.0, 0.0],
    )  # fmt: skip
    first, *others = bounds(ocp.compile_problem(declared), term=2)
    assert len(others) == 19
    assert all(np.array_equal(first, other) for other in others)


def test_rows_do_not_apply_while_their_bound_is_infinite():
    late = ocp.over_phase(lambda at: 0.3 if at.t > 0.2 else np.inf)
    compiled = ocp.compile_problem(cart(ocp.inequality(place, upper=late, name="late", unit="m", when="go")))
    go, stay = compiled.phases
    np.testing.assert_array_equal(go.g_mask[:, 0], [0, 0, 0, 0, 0, 1, 1, 1, 1, 1])
    assert np.all(stay.g_mask == 0)


def test_a_function_is_called_only_for_phases_where_the_constraint_applies():
    def upper(at):
        assert at.phase == "stay"
        return 1.0

    ocp.compile_problem(cart(ocp.inequality(place, upper=ocp.over_phase(upper), name="limit", unit="m", when="stay")))


def test_bounds_at_a_phases_end_are_those_of_its_duration():
    end = ocp.inequality(place, lower=ocp.over_phase(lambda at: at.t), at="phase_end", name="end", unit="m")
    found = bounds(ocp.compile_problem(cart(end)), "lower")
    assert [each[-1, 0] for each in found] == pytest.approx([0.5, 0.3])


def test_constant_bounds_and_bounds_over_a_phase_share_their_code():
    limits = [ocp.inequality(place, upper=upper, name="limit", unit="m") for upper in (1.0, ocp.over_phase(ceiling))]
    ocp.compile_problem(cart(limits[0]))
    assert ocp.compile_problem(cart(limits[1])).lowered == 0


# ---- solutions


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_a_solution_keeps_bounds_at_every_node_and_touches_them(backend):
    limit = ocp.inequality(place, upper=ocp.over_phase(ceiling), name="ceiling", unit="m", when="go")
    compiled = ocp.compile_problem(cart(limit))
    solution = solvers.MSiLQR(compiled, backend=backend).solve().raise_if_failed()
    go, stay = solution.trajectory.phases
    room = 1.0 - 0.8 * np.linspace(0, 1, 11) - go.states[:, 0]
    assert room.min() == pytest.approx(0.0, abs=2e-3)
    assert room[0] > 0.5  # only the end of the phase is tight
    assert stay.states[-1, 0] > 0.3  # no limit in the second phase
    assert ocp.verify(compiled, solution.trajectory).max_inequality < 1e-3


def test_both_backends_find_the_same_solution():
    compiled = ocp.compile_problem(cart(ocp.inequality(place, upper=ocp.over_phase(ceiling), name="c", unit="m")))
    one, two = (solvers.MSiLQR(compiled, backend=backend).solve() for backend in ("native", "numpy"))
    np.testing.assert_allclose(one.states, two.states, atol=1e-9)


def test_verify_measures_against_the_bound_of_each_node():
    free = solvers.MSiLQR(cart()).solve().raise_if_failed()
    limit = ocp.inequality(place, upper=ocp.over_phase(ceiling), name="ceiling", unit="m")
    found = ocp.verify(ocp.compile_problem(cart(limit)), free.trajectory)
    over = [
        np.max(part.states[:, 0] - (1 - 0.8 * np.linspace(0, 1, len(part.times)))) for part in free.trajectory.phases
    ]
    assert found.max_inequality == pytest.approx(max(over), abs=1e-9)


def test_pushes_grow_with_a_bound_that_grows():
    grows = ocp.over_phase(lambda at: 10.0 * at.t)
    limit = ocp.inequality(push, upper=grows, name="motor", unit="N", when="go")
    solution = solvers.MSiLQR(cart(limit)).solve().raise_if_failed()
    used = solution.trajectory.phases[0].controls[:, 0]
    assert np.all(used <= 10.0 * np.linspace(0, 0.45, 10) + 1e-3)
    assert used[1:5] == pytest.approx(10.0 * np.linspace(0.05, 0.2, 4), abs=0.05)


def test_a_batch_solves_with_them_as_single_solves_do():
    compiled = ocp.compile_problem(cart(ocp.inequality(place, upper=ocp.over_phase(ceiling), name="c", unit="m")))
    starts = np.array([[0.0, 0.0], [0.1, 0.5]])
    batch = solvers.solve_batch(compiled, starts)
    for i, start in enumerate(starts):
        alone = solvers.MSiLQR(compiled.with_start(start)).solve().raise_if_failed()
        np.testing.assert_allclose(batch.states[i], alone.states, atol=1e-9)


# ---- horizons, planners, samples


def legged(head, tail):
    """A jump of a quadruped, planned with two models, whose base stays between bounds that move."""
    body, srb = quadruped()
    objective = ocp.Objective(
        ocp.track(base.position, weight=(0, 1, 30)), ocp.regularize(models.joints.torque, weight=0.05),
        ocp.regularize(models.feet.force, weight=0.01),
    )  # fmt: skip
    limits = ocp.Constraints(
        models.base_height(
            ocp.over_phase(lambda at: 0.1 + 0.05 * at.share), maximum=ocp.over_phase(lambda at: 0.5 - 0.3 * at.t)
        ),
        models.friction_cone(mu=0.6),
        ocp.inequality(
            lambda s: s.joints.torque, name="drive", unit="Nm",
            upper=ocp.over_phase(lambda at: at.model.robot.torque_limit * (1 - 0.5 * at.share)),
        ),
    )  # fmt: skip
    schedule = body.over(head, dt=0.01) + srb.over(tail, dt=0.05) if tail else body.over(head, dt=0.01)
    return ocp.Problem(turning_jump(), schedule, objective, limits, initial=body.state(joints="stand"))


@pytest.mark.parametrize("tail", [0.0, 0.3])
def test_a_horizon_at_any_time_has_the_compilers_bounds(tail):
    declared = legged(0.1, tail)
    horizon = ocp.Horizon(declared)
    for k in range(0, 58 - round(100 * (0.1 + tail)) + 1, 3):
        x = on_path(horizon, 0.01 * k)
        got = horizon.at(horizon.begin(x, 0.01 * k), x)
        assert_same(got, ocp.compile_problem(declared, 0.01 * k, checks=False).with_start(x))


def test_a_plan_keeps_the_bounds_of_its_own_times():
    limit = ocp.inequality(place, upper=ocp.over_phase(ceiling), name="ceiling", unit="m", when="go")
    phases = (("go", 0.5), ("stay", 0.5))
    declared = cart(limit, phases=phases)
    schedule = CART.over(0.3, dt=0.05)
    declared = ocp.Problem(
        declared.motion, schedule, declared.objective, declared.constraints, initial=declared.initial
    )
    planner = solvers.RecedingHorizon(
        declared, period=0.05, iterations=30, barrier=solvers.Fixed(weight=1e-4, relaxation=1e-4)
    )
    x = declared.initial
    tight = []
    for k in range(6):
        t = 0.05 * k
        plan = planner.plan(x, t)
        nodes = [
            (time, state[0])
            for part in plan.phases
            for time, state in zip(part.times, part.states, strict=True)
            if time < 0.5 + 1e-9
        ]
        room = [1.0 - 0.8 * time / 0.5 - where for time, where in nodes]
        assert min(room) > -2e-3, f"plan at {t} s"
        tight.append(min(room))
        x = plan.phases[0].states[1]
    assert min(tight) < 0.05  # the ceiling is what limits the cart


def test_limits_of_the_robot_take_a_fraction_that_varies():
    body, _ = quadruped()
    fades = ocp.over_phase(lambda at: 1.0 - 0.5 * at.share)
    declared = ocp.Problem(
        turning_jump(), body.until_end(dt=0.01), ocp.Objective(ocp.regularize(models.joints.torque, weight=0.05)),
        ocp.Constraints(models.torque_limits(fades), models.joint_speed_limits(fades)),
        initial=body.state(joints="stand"),
    )  # fmt: skip
    compiled = ocp.compile_problem(declared)
    share = np.linspace(0.0, 1.0, 13)[:, None]  # of the first phase
    for term, limit in ((1, body.robot.torque_limit), (2, body.robot.joint_speed_limit)):
        np.testing.assert_allclose(bounds(compiled, "upper", term)[0], (1 - 0.5 * share) * limit)
        np.testing.assert_allclose(bounds(compiled, "lower", term)[0], (0.5 * share - 1) * limit)
    never = ocp.Constraints(models.torque_limits(ocp.over_phase(lambda at: 0.1 - at.t)))
    wrong = ocp.Problem(declared.motion, declared.schedule, declared.objective, never, initial=declared.initial)
    with pytest.raises(ProblemError, match="phase 'push', 0.11 s after its start: bounds exclude each other"):
        ocp.compile_problem(wrong)
    with pytest.raises(ProblemError, match="fraction is out of range - got 0"):
        models.torque_limits(0)


def test_nodes_of_sampled_motions_have_them():
    robot = models.load("solo12")
    plant = models.Mujoco(robot)
    limit = ocp.inequality(
        lambda s: s.base.height, lower=ocp.over_phase(lambda at: at.share), name="floor", unit="m"
    )  # fmt: skip
    motion = ocp.Motion(*(ocp.Phase(name, stance(roles="all"), 0.1) for name in ("one", "two")))
    objective = ocp.Objective(ocp.track(base.position, 1.0), ocp.regularize(models.joints.target, 1e-3))
    declared = ocp.Problem(
        motion, plant.until_end(dt=0.02), objective, ocp.Constraints(limit),
        initial=models.WholeBody(robot).state(joints="stand"),
    )  # fmt: skip
    nodes = ocp.Nodes(declared)
    slices = nodes.mode.layout.slices
    found = nodes.running(0, 10).p[:, slices[ParameterKey("lower", term=2)]][:, 0]
    np.testing.assert_allclose(found, [*np.linspace(0, 0.8, 5), *np.linspace(0, 0.8, 5)], atol=1e-12)


# ---- parameters, copies, reports


def test_a_bound_over_a_phase_is_no_parameter_and_the_other_side_is():
    limit = ocp.inequality(place, lower=-1.0, upper=ocp.over_phase(ceiling), name="limit", unit="m")
    compiled = ocp.compile_problem(cart(limit))
    assert "limit.lower" in compiled.parameters
    assert "limit.upper" not in compiled.parameters
    changed = compiled.with_parameters({"limit.lower": -2.0})
    assert all(np.all(each == -2.0) for each in bounds(changed, "lower"))
    np.testing.assert_array_equal(bounds(changed)[0], bounds(compiled)[0])
    for refused in (compiled.with_parameters, lambda p: ocp.compile_problem(cart(limit).with_parameters(p))):
        with pytest.raises(ProblemError, match=r"parameter 'limit.upper': varies over a phase - got a number for it"):
            refused({"limit.upper": 1.0})
    with pytest.raises(ProblemError, match="bounds exclude each other"):
        compiled.with_parameters({"limit.lower": 0.5})


def test_a_problem_with_them_is_pickled_and_a_lambda_is_named():
    named = cart(ocp.inequality(place, upper=ocp.over_phase(ceiling), name="limit", unit="m"))
    limit = next(iter(named.constraints))
    again = pickle.loads(pickle.dumps(limit))
    assert again.upper.function is ceiling
    refused = ocp.inequality(place, upper=ocp.over_phase(lambda at: at.t), name="limit", unit="m")
    with pytest.raises(ProblemError, match=r"constraint 'limit' \(test_over_phase.py:\d+\): cannot be sent .* got a "):
        pickle.dumps(refused)


def test_describe_says_that_bounds_vary():
    limits = [
        ocp.inequality(place, upper=ocp.over_phase(ceiling), name="moving", unit="m"),
        ocp.inequality(push, upper=5.0, name="fixed", unit="N"),
    ]
    lines = ocp.describe(ocp.compile_problem(cart(*limits))).splitlines()
    assert any(line.startswith("moving") and "inequality, bounds over phases" in line for line in lines)
    assert not any(line.startswith("fixed") and "over phases" in line for line in lines)


def test_warnings_see_the_bounds_of_every_node():
    down = ocp.inequality(place, upper=ocp.over_phase(lambda at: 1 - at.t), name="down", unit="m", when="go")
    floor = ocp.inequality(lambda s: 1.0 * s.x, lower=0.6, name="floor", unit="m", when="go")
    found = [str(each.text) for each in ocp.find_warnings(ocp.compile_problem(cart(down, floor)))]
    assert sum("two rows exclude each other" in text for text in found) == 1
    fits = ocp.inequality(lambda s: 1.0 * s.x, lower=0.4, name="floor", unit="m", when="go")
    found = [str(each.text) for each in ocp.find_warnings(ocp.compile_problem(cart(down, fits)))]
    assert not any("two rows exclude each other" in text for text in found)


def test_a_figure_draws_bounds_that_move(tmp_path):
    limit = ocp.inequality(
        push, lower=-8.0, upper=ocp.over_phase(lambda at: 10.0 * at.t), name="push limit", unit="", when="go"
    )  # fmt: skip
    solution = solvers.MSiLQR(cart(limit)).solve()
    saved = solvers.Solution.load(solution.save(tmp_path / "cart.npz"))
    for each in (solution, saved):
        panel = next(panel for panel in panels(each) if panel.title == "push")
        assert panel.bounds == ((-8.0, None),)
        ((times, values),) = panel.moving_bounds
        np.testing.assert_allclose(times[:11], np.linspace(0, 0.5, 11), atol=1e-12)
        np.testing.assert_allclose(values[:10], 10.0 * np.linspace(0, 0.45, 10), atol=1e-9)
        assert np.all(np.isnan(values[11:]))  # there is no limit in the second phase
        axes = next(axes for axes in draw(each).axes if axes.get_title(loc="left") == "push")
        assert any(np.array_equal(line.get_ydata(), values, equal_nan=True) for line in axes.lines)


# ---- errors


@pytest.mark.parametrize(
    ("function", "error", "told"),
    [
        (lambda at: [1.0, 2.0], ShapeError, r"upper bound is unusable - got \[1.0, 2.0\], expected 1 or 1 numbers"),
        (lambda at: [[1.0]], ShapeError, r"upper bound is unusable - got \[\[1.0\]\], expected 1 or 1 numbers \[m\]"),
        (lambda at: np.nan if at.t > 0.32 else 1.0, ShapeError, r"0.35 s after its start: upper bound is unusable"),
        (lambda at: "high", ProblemError, r"upper bound is unusable - got 'high', expected numbers"),
        (lambda at: 1 / (0.1 - at.t), ProblemError, r"0.1 s after its start: upper bound: the function fails at test"),
        (lambda at: at.height, ProblemError, r"got AttributeError: 'PhaseTime' object has no attribute 'height'"),
        (lambda at: 0.2 - at.t, ProblemError, r"row 0, phase 'go', 0.25 s after its start: bounds exclude each other - "
         r"got lower 0 above upper -0.05 \[m\]"),
    ],
)  # fmt: skip
def test_a_bound_that_is_unusable_is_told_with_line_phase_and_time(function, error, told):
    limit = ocp.inequality(place, lower=0.0, upper=ocp.over_phase(function), name="limit", unit="m")
    with pytest.raises(error, match=told) as caught:
        ocp.compile_problem(cart(limit))
    assert str(caught.value).startswith("constraint 'limit' (test_over_phase.py:")
    assert "phase 'go'" in str(caught.value)


def test_what_is_not_a_function_is_refused_where_it_is_declared():
    with pytest.raises(ProblemError, match=r"over_phase \(test_over_phase.py:\d+\): is not a function - got 0.3"):
        ocp.over_phase(0.3)


def test_a_function_of_time_without_over_phase_is_told_about_it():
    limit = ocp.inequality(place, upper=lambda at: 1.0 - at.share, name="limit", unit="m")
    with pytest.raises(ProblemError, match=r"as ocp.over_phase\(function\)"):
        ocp.compile_problem(cart(limit))
