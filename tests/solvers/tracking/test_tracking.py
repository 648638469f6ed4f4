"""Low-level controllers: what they return, which rows count, and what happens if a number is bad."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ProblemError, ShapeError, SolverError, UnknownNameError
from piaffe.models import joints, stance
from piaffe.solvers import FeedforwardPD, JointPD, PlanPhase, QpStatus, Riccati, SolvedPlan, Vwbc
from piaffe.solvers.tracking import ControlRows, stage_at
from tests.problems import bouncing_ball, swing_up


@cache
def solved(make):
    """Return a compiled problem and its solution."""
    compiled = ocp.compile_problem(make())
    return compiled, solvers.MSiLQR(compiled, backend="numpy").solve().raise_if_failed()


def plan_of(make):
    compiled, solution = solved(make)
    return SolvedPlan(solution, compiled)


def slider(*limits, weight=0.01):
    """A mass on a rail under a force, whose acceleration is an implicit variable, moves by 1 m."""
    mass = ocp.Model(
        "mass", state={"place": 1, "speed": 1}, control={"force": 1},
        modes={"slide": lambda s: {"place": s.speed, "speed": s.force}},
    )  # fmt: skip
    motion = ocp.Motion(ocp.Phase("slide", "slide", 0.5, {"place": 1.0}))
    objective = ocp.Objective(
        ocp.track("place", 20.0), ocp.regularize("speed", 0.1), ocp.regularize("force", weight),
        ocp.track("place", 100.0, at="end"),
    )  # fmt: skip
    return ocp.Problem(motion, mass.until_end(dt=0.05), objective, ocp.Constraints(*limits), initial=[0.0, 0.0])


def bounded():
    return slider(ocp.inequality(lambda s: s.force, lower=-30, upper=20, name="force limit", unit="N"))


def two_forces(*limits):
    """A mass on a rail under the sum of two forces moves by 1 m; its cost has one weight per force."""
    mass = ocp.Model(
        "mass", state={"place": 1, "speed": 1}, control={"force": 2},
        modes={"slide": lambda s: {"place": s.speed, "speed": s.force[0] + s.force[1]}},
    )  # fmt: skip
    motion = ocp.Motion(ocp.Phase("slide", "slide", 0.3, {"place": 1.0}))
    objective = ocp.Objective(ocp.track("place", 20.0), ocp.regularize("force", (0.01, 0.05)))
    return ocp.Problem(motion, mass.until_end(dt=0.05), objective, ocp.Constraints(*limits), initial=[0.0, 0.0])


class OneStage:
    """A plan of one stage of a whole body, with an action value made by hand."""

    def __init__(self, compiled, x, u, **changes):
        phase, (ndx, nu) = compiled.phases[0], (compiled.phases[0].mode.state.ndx, len(u))
        rng = np.random.default_rng(0)
        root = rng.standard_normal((nu, nu))
        hessian, mixed = root @ root.T + np.eye(nu), 5 * rng.standard_normal((nu, ndx))
        self.compiled = compiled
        made = PlanPhase(
            phase.mode, np.array([0.0, 0.01]), np.array([x, x]), u[None], -np.linalg.solve(hessian, mixed)[None],
            np.zeros((1, nu)), mixed[None], hessian[None], phase.p[:1], phase.g_mask[:1], phase.h_mask[:1],
        )  # fmt: skip
        self.phases = (replace(made, **{name: value[None] for name, value in changes.items()}),)
        self.mode, self.stage = phase.mode, stage_at(self, 0.0)

    def row_name(self, mode, kind, row):
        return self.compiled.row_name(mode.rows[f"stage_{kind}"][row])


@cache
def standing(feet_down="FL HR"):
    """A Mini Cheetah on two feet: model, problem, state, and torques that hold it about still."""
    robot = models.load("mini_cheetah")
    body = models.WholeBody(robot)
    motion = ocp.Motion(ocp.Phase("stand", stance(feet_down), 0.1))
    limits = ocp.Constraints(models.friction_cone(0.6), models.torque_limits(), models.joint_limits())
    objective = ocp.Objective(ocp.regularize(joints.torque, weight=1.0))
    problem = ocp.Problem(motion, body.until_end(dt=0.01), objective, limits, initial=body.state(joints="stand"))
    compiled = ocp.compile_problem(problem)
    return body, compiled, compiled.initial, compiled.phases[0].guess_controls[0]


def pushed(compiled, x, size, seed=0):
    """Return a state with random velocities of the base and of the joints."""
    space = compiled.phases[0].mode.state
    delta = np.zeros(space.ndx)
    delta[-18:] = size * np.random.default_rng(seed).standard_normal(18)
    return space.np_plus(x, delta)


def rows_at(compiled, x, u, dt=0.0, row=lambda name: True):
    """Return the rows of the first stage that depend on control or force, by its own functions, and z."""
    phase = compiled.phases[0]
    f, p = phase.mode.functions, phase.p[0].copy()
    p[0] = dt
    K, r0 = (np.array(part) for part in f["implicit"](x, u, p))
    z = -np.linalg.solve(K, r0)
    g = np.array(f["stage"](x, u, z, p)[2]).ravel()
    use = [
        phase.g_mask[0, i] > 0 and ("friction" in name or "torque" in name) and row(name)
        for i, name in enumerate(map(compiled.row_name, phase.mode.rows["stage_g"]))
    ]
    return g[use], z.ravel()


# ---- the control


@pytest.mark.parametrize("make", [bounded, swing_up, bouncing_ball])
def test_without_active_rows_vwbc_is_the_policy_with_its_feedforward(make):
    compiled, solution = solved(make)
    controller, rng = Vwbc(SolvedPlan(solution, compiled)), np.random.default_rng(0)
    free = 0
    for t in np.linspace(0.0, solution.trajectory.phases[-1].times[-1] - 1e-3, 23):
        planned = solution.policy.planned(t)
        space = planned.part.state
        deviation = 1e-4 * rng.standard_normal(space.ndx)
        u = controller.control(space.np_plus(planned.state, deviation), t)
        policy = solution.phases[planned.phase]
        expected = planned.part.controls[planned.stage] + policy.feedforward[planned.stage]
        expected = expected + policy.feedback[planned.stage] @ deviation
        if not controller.last.active:
            np.testing.assert_allclose(u, expected, rtol=1e-7, atol=1e-8)
            free += 1
    assert free > 5


def test_a_bounded_control_reaches_its_bound_and_says_so():
    controller = Vwbc(plan_of(bounded))
    assert controller.control([-3.0, 0.0], 0.0) == pytest.approx([20.0])
    assert controller.last.active == ("force limit upper",)
    assert controller.control([3.0, 0.0], 0.0) == pytest.approx([-30.0])
    assert controller.limits == ("force limit lower", "force limit upper")
    assert Riccati(plan_of(bounded)).control([-3.0, 0.0], 0.0) == pytest.approx([20.0])
    assert controller.statuses == {QpStatus.SOLVED: 2}


@pytest.mark.parametrize("qp", ["own", "numpy", "daqp"])
def test_torques_and_forces_keep_their_limits_where_the_policy_does_not(qp):
    if qp == "daqp":
        pytest.importorskip("daqp")
    _, compiled, x, u = standing()
    controller, policy = Vwbc(OneStage(compiled, x, u), qp=qp), Riccati(OneStage(compiled, x, u))
    missed = 0
    for seed in range(20):
        state = pushed(compiled, x, 0.5, seed)
        limited, _ = rows_at(compiled, state, controller.control(state, 0.0))
        free, _ = rows_at(compiled, state, policy.control(state, 0.0))
        if controller.last.status is QpStatus.SOLVED:
            assert limited.min() > -1e-6
        missed += free.min() < -1e-3
    assert controller.statuses[QpStatus.SOLVED] > 15
    assert missed > 10


def test_no_other_control_within_the_limits_has_a_smaller_action_value():
    _, compiled, x, u = standing()
    plan = OneStage(compiled, x, u)
    at, controller, rng, compared = plan.stage, Vwbc(plan), np.random.default_rng(1), 0
    for seed in range(5):
        state = pushed(compiled, x, 0.5, seed)
        best = controller.control(state, 0.0)
        if controller.last.status is not QpStatus.SOLVED:
            continue
        deviation = at.mode.state.np_minus(state, at.x)

        def value(control, deviation=deviation):
            du = control - at.u
            return (at.Q_u + at.Q_ux @ deviation) @ du + 0.5 * du @ at.Q_uu @ du

        for _ in range(200):
            other = best + rng.standard_normal(12) * 10.0 ** rng.uniform(-4, 0)
            if rows_at(compiled, state, other)[0].min() >= 0:
                assert value(other) >= value(best) - 1e-9 * abs(value(best))
                compared += 1
    assert compared > 100


def test_forces_are_those_of_the_continuous_dynamics():
    """With a step of zero length; the whole body computes them by its own numeric functions."""
    body, compiled, x, u = standing()
    plan, state = OneStage(compiled, x, u), pushed(compiled, x, 0.3)
    rows = ControlRows(plan.phases[0].mode)
    p = plan.stage.p.copy()
    p[0] = 0.0
    made = rows(state, u, p, plan.stage.g_mask, plan.stage.h_mask)
    du = np.random.default_rng(0).standard_normal(12)
    gain = {"gamma": p[plan.phases[0].mode.layout.slots["gamma"]]}
    z = made.z + made.z_u @ du
    np.testing.assert_allclose(z[:18], body.acceleration(state, u + du, "FL HR", **gain), rtol=1e-8, atol=1e-8)
    forces = body.contact_forces(state, u + du, "FL HR", **gain)
    np.testing.assert_allclose(z[18:], np.ravel(forces), rtol=1e-8, atol=1e-8)
    affine, _ = rows_at(compiled, state, u + du)
    np.testing.assert_allclose(made.C @ du - made.d, affine, rtol=1e-8, atol=1e-8)
    assert rows.not_affine == ()


def test_components_of_the_state_can_be_left_out():
    _, compiled, x, u = standing()
    plan = OneStage(compiled, x, u)
    moved = x.copy()
    moved[:2] += 0.1
    there = Riccati(plan, leave_out=("base.position x", "base.position y"))
    np.testing.assert_allclose(there.control(moved, 0.0), there.control(x, 0.0), atol=1e-12)
    assert np.abs(Riccati(plan).control(moved, 0.0) - there.control(x, 0.0)).max() > 0.01
    moved[2] += 0.1
    whole = Riccati(plan, leave_out=("base.position",))
    np.testing.assert_allclose(whole.control(moved, 0.0), whole.control(x, 0.0), atol=1e-12)
    with pytest.raises(UnknownNameError, match="Riccati: no component of the state 'base.position w'"):
        Riccati(plan, leave_out=("base.position w",))


def test_gains_act_on_the_joints():
    _, compiled, x, u = standing()
    plan, delta = OneStage(compiled, x, u), np.zeros(36)
    delta[[6, 24]] = 0.1, 0.5  # the first joint's angle and speed
    state = compiled.phases[0].mode.state.np_plus(x, delta)
    expected = u.copy()
    expected[0] -= 10 * 0.1 + 2 * 0.5
    np.testing.assert_allclose(FeedforwardPD(plan, kp=10, kd=2).control(state, 0.0), expected, atol=1e-12)
    with_gains = Riccati(plan, gains=JointPD(10, 2)).control(state, 0.0)
    np.testing.assert_allclose(with_gains - Riccati(plan).control(state, 0.0), expected - u, atol=1e-12)
    with pytest.raises(SolverError, match="got controls force, expected a block of the state with these labels"):
        FeedforwardPD(plan_of(bounded))


def test_slots_of_the_model_can_have_other_values():
    _, compiled, x, u = standing()
    plan, changed = OneStage(compiled, x, u), 0
    for seed in range(10):
        state = pushed(compiled, x, 0.3, seed)
        default, zero = Vwbc(plan).control(state, 0.0), Vwbc(plan, slots={"gamma": 0.0}).control(state, 0.0)
        changed += np.abs(default - zero).max() > 0.01
    assert changed > 2
    with pytest.raises(UnknownNameError, match="no slot 'gama'"):
        Vwbc(plan, slots={"gama": 1.0})
    with pytest.raises(ShapeError, match="slot 'gravity': wrong size - got 2 entries, expected 3"):
        Vwbc(plan, slots={"gravity": (0, 1)})


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_measured_contacts_replace_those_of_the_schedule(backend):
    _, compiled, x, u = standing()
    controller = Vwbc(OneStage(compiled, x, u), backend=backend)

    def presses(state):
        controller.control(state, 0.0)
        return any("friction cone" in name for name in controller.last.active)

    state = next(s for s in (pushed(compiled, x, 0.3, seed) for seed in range(20)) if presses(s))
    scheduled = controller.control(state, 0.0)
    controller.measure({"contact": np.zeros(4)})
    flying = controller.control(state, 0.0)
    assert not any("friction cone" in name for name in controller.last.active)
    assert len(controller.program(state, 0.0).d) == 24
    assert np.abs(flying - scheduled).max() > 0.1
    controller.measure({"contact": (1, 0, 0, 1)})
    np.testing.assert_array_equal(controller.control(state, 0.0), scheduled)
    controller.measure({"contact": (1, 1, 1, 1)})
    assert len(controller.program(state, 0.0).d) == 44
    controller.measure()
    np.testing.assert_array_equal(controller.control(state, 0.0), scheduled)
    with pytest.raises(UnknownNameError, match="no slot 'contacts'"):
        controller.measure({"contacts": 1})


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_another_plan_is_followed_without_a_new_controller(backend):
    _, compiled, x, u = standing()
    first, second = OneStage(compiled, x, u), OneStage(compiled, x, 0.5 * u, Q_u=np.ones(12))
    controller, state = Vwbc(first, backend=backend), pushed(compiled, x, 0.1)
    controller.measure({"gamma": 10.0})
    before = controller.control(state, 0.0)
    controller.follow(second)
    fresh = Vwbc(second, backend=backend)
    fresh.measure({"gamma": 10.0})
    np.testing.assert_array_equal(controller.control(state, 0.0), fresh.control(state, 0.0))
    assert np.abs(before - controller.control(state, 0.0)).max() > 0.1
    with pytest.raises(SolverError, match="the plan has other modes - got 'ball' fall, expected modes of the first"):
        controller.follow(plan_of(bouncing_ball))


# ---- which rows


def test_rows_of_the_state_alone_are_left_out_and_listed():
    _, compiled, x, u = standing()
    controller = Vwbc(OneStage(compiled, x, u))
    assert len(controller.limits) == 44
    assert all(name.startswith(("friction cone", "torque limits")) for name in controller.limits)
    assert len(controller.left_out) == 24
    assert all(name.startswith("joint limits") for name in controller.left_out)


def test_a_running_equality_of_the_control_holds():
    compiled = ocp.compile_problem(two_forces(ocp.equality(lambda s: s.force[0] - 2 * s.force[1], name="share")))
    solution = solvers.MSiLQR(compiled, backend="numpy").solve().raise_if_failed()
    controller = Vwbc(SolvedPlan(solution, compiled))
    for place in (-1.0, 0.0, 2.0):
        u = controller.control([place, 0.3], 0.1)
        assert u[0] == pytest.approx(2 * u[1], rel=1e-9)
    assert controller.limits == ("share",)
    assert abs(controller.control([-1.0, 0.0], 0.1)[0] - controller.control([1.0, 0.0], 0.1)[0]) > 1.0


def test_a_row_that_is_not_affine_is_linearised_at_the_plan():
    def power():
        return slider(ocp.inequality(lambda s: 400.0 - s.force**2, lower=0.0, name="square", unit="N²"))

    compiled = ocp.compile_problem(power())
    solution = solvers.MSiLQR(compiled, backend="numpy").solve().raise_if_failed()
    plan = SolvedPlan(solution, compiled)
    controller, planned = Vwbc(plan), plan.phases[0].controls[0, 0]
    assert controller.rows[plan.phases[0].mode].not_affine == (0,)
    u = controller.control([-3.0, 0.0], 0.0)[0]
    assert 400 - planned**2 - 2 * planned * (u - planned) == pytest.approx(0.0, abs=1e-6)


def test_bounds_of_single_controls_may_depend_on_the_state():
    def slower():
        return slider(ocp.inequality(lambda s: 20.0 - 4 * s.speed - s.force, lower=0.0, name="motor", unit="N"))

    compiled = ocp.compile_problem(slower())
    solution = solvers.MSiLQR(compiled, backend="numpy").solve().raise_if_failed()
    plan = SolvedPlan(solution, compiled)
    for controller in (Vwbc(plan), Riccati(plan)):
        assert controller.control([-3.0, 1.0], 0.0) == pytest.approx([16.0])
        assert controller.control([-3.0, 2.0], 0.0) == pytest.approx([12.0])


def test_a_problem_without_such_rows_is_warned_of():
    compiled = ocp.compile_problem(slider())
    solution = solvers.MSiLQR(compiled, backend="numpy").solve().raise_if_failed()
    with pytest.warns(UserWarning, match="vwbc: no constraint depends on control or contact force"):
        Vwbc(SolvedPlan(solution, compiled))


# ---- the plan


def test_states_are_not_interpolated_across_a_reset():
    compiled, solution = solved(bouncing_ball)
    plan, before = SolvedPlan(solution, compiled), solution.trajectory.phases[0]
    down, up = stage_at(plan, 0.45 - 1e-6).x, stage_at(plan, 0.45).x
    np.testing.assert_allclose(down, before.states[-1], atol=1e-4)
    np.testing.assert_allclose(up, solution.trajectory.phases[1].states[0], atol=1e-12)
    assert down[1] < -2 < 2 < up[1]
    middle = stage_at(plan, before.times[3] + 0.25 * 0.025)
    np.testing.assert_allclose(middle.x, 0.75 * before.states[3] + 0.25 * before.states[4])
    np.testing.assert_allclose(middle.u, before.controls[3])


def test_before_and_after_the_plan_its_first_and_last_stage_apply():
    compiled, solution = solved(bouncing_ball)
    plan = SolvedPlan(solution, compiled)
    assert stage_at(plan, -1.0).u == solution.trajectory.phases[0].controls[0]
    assert stage_at(plan, 9.0).u == solution.trajectory.phases[1].controls[-1]
    np.testing.assert_allclose(stage_at(plan, 9.0).x, solution.trajectory.phases[1].states[-1])


def test_a_solution_of_another_problem_is_refused():
    with pytest.raises(ProblemError, match="is not of this problem"):
        SolvedPlan(solved(bouncing_ball)[1], solved(swing_up)[0])
    compiled, solution = solved(bounded)
    blank = replace(solution.phases[0], Q_uu=np.zeros_like(solution.phases[0].Q_uu))
    with pytest.raises(SolverError, match="phase 'slide': the solution has no policy - got a Hessian"):
        SolvedPlan(replace(solution, phases=(blank,)), compiled)


# ---- bad numbers


def test_limits_on_forces_give_way_where_no_torque_keeps_them():
    """A foot that slides fast under a gain of the contacts: no torque within the limits holds it in its cone."""
    _, compiled, x, u = standing()
    controller = Vwbc(OneStage(compiled, x, u))
    for seed in range(20):
        state = pushed(compiled, x, 20.0, seed)
        got = controller.control(state, 0.0)
        made = controller.program(state, 0.0)
        slack = made.C @ (got - u) - made.d
        size = 1 + np.abs(made.d).max()
        assert (slack[~made.soft] > -1e-9 * size).all()
        if controller.last.status is QpStatus.RELAXED:
            assert controller.last.excess > 0
            assert -slack[made.soft].min() == pytest.approx(controller.last.excess, rel=1e-6)
    assert controller.relaxed > 0
    assert (controller.ticks, controller.damped, controller.fallbacks) == (20, 0, 0)


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_a_program_without_a_solution_falls_back_to_the_clipped_policy(backend):
    """The sum of two forces has a bound that depends on the speed, and rows of the control alone do not give way."""
    problem = two_forces(
        ocp.inequality(lambda s: s.force[0] + s.force[1] - 50 * s.speed, lower=-30.0, name="sum"),
        ocp.inequality(lambda s: s.force, lower=-20.0, upper=20.0, name="force"),
    )
    compiled = ocp.compile_problem(problem)
    plan = SolvedPlan(solvers.MSiLQR(compiled, backend="numpy").solve(), compiled)
    controller, policy = Vwbc(plan, backend=backend), Riccati(plan)
    for speed in (0.5, 2.0):
        got = controller.control([0.0, speed], 0.1)
        assert (np.abs(got) <= 20.0 + 1e-9).all()
    np.testing.assert_allclose(got, policy.control([0.0, speed], 0.1), atol=1e-12)
    assert controller.statuses == {QpStatus.SOLVED: 1, QpStatus.INFEASIBLE: 1}
    assert (controller.fallbacks, controller.relaxed) == (1, 0)


def test_a_state_that_is_not_finite_gives_damping():
    body, compiled, x, u = standing()
    for controller in (make(OneStage(compiled, x, u), damping=0.7) for make in (Vwbc, Riccati, FeedforwardPD)):
        state = pushed(compiled, x, 1.0)
        speed = state[-12:].copy()
        state[0], state[-3] = np.nan, np.inf
        got = controller.control(state, 0.0)
        expected = -0.7 * speed
        expected[-3] = 0.0
        np.testing.assert_allclose(got, expected, atol=1e-12)
        assert controller.damped == 1
    assert (np.abs(got) <= body.robot.torque_limit).all()


def test_a_plan_that_is_not_finite_gives_damping():
    _, compiled, x, u = standing()
    broken = OneStage(compiled, x, u, Q_ux=np.full((12, 36), np.nan), feedback=np.full((12, 36), np.nan))
    controller = Vwbc(broken)
    assert controller.control(x, 0.0) == pytest.approx(np.zeros(12))
    assert (controller.damped, controller.statuses[QpStatus.NOT_FINITE]) == (1, 1)


def test_a_state_of_another_robot_is_refused():
    _, compiled, x, u = standing()
    expected = "Vwbc: state has the wrong size - got shape (36,), expected (37,); give a state of model 'mini_cheetah'"
    with pytest.raises(ShapeError, match=re.escape(expected)):
        Vwbc(OneStage(compiled, x, u)).control(x[:-1], 0.0)
