"""Ticks in C equal those in NumPy: numbers, shift, prediction, impact at the start, iterations, policy, commands."""

import gc
from functools import lru_cache

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ProblemError, ShapeError, SolverError, UnknownNameError
from piaffe.models import base, feet, joints, stance

TABLES = ("times", "p", "g_mask", "h_mask", "p_transition")
RESULTS = ("states", "controls", "feedforward", "feedback", "Q_x", "Q_u", "Q_xx", "Q_ux", "Q_uu")


@lru_cache(maxsize=1)
def quadruped():
    robot = models.load("mini_cheetah")
    return models.WholeBody(robot), models.SingleRigidBody(robot)


def swing(s):
    return 1 - s.feet.contact


@lru_cache(maxsize=1)
def terms():
    objective = ocp.Objective(
        ocp.track(base.position, weight=(0, 1, 30)), ocp.track(base.orientation, weight=(5, 2, 2)),
        ocp.track(base.linear_velocity, weight=2.0), ocp.track(base.angular_velocity, weight=1.0),
        ocp.track(joints.position, weight=1.0), ocp.track(joints.velocity, weight=0.05),
        ocp.regularize(joints.torque, weight=0.02), ocp.track(base.position, weight=(0, 1, 50), at="phase_end"),
        models.soft_landing(weight=0.1),
    )  # fmt: skip
    limits = ocp.Constraints(
        models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(), models.foot_clearance(minimum=0.0)
    )
    return objective, limits, ocp.regularize(feet.force, weight=0.01)


def hop_then(gait):
    """A hop with keyframes, then a gait without end."""
    return (
        ocp.Motion(
            ocp.Phase("push", stance("FL FR HL HR"), 0.12, ocp.Keyframe(position=(0.05, 0, 0.3))),
            ocp.Phase("air", stance(""), 0.1, ocp.Keyframe(position=(0.15, 0.02, 0.28), rpy=(0, 0, 0.2))),
            ocp.Phase("land", stance("FL FR HL HR"), 0.12, ocp.Keyframe(position=(0.15, 0.02, 0.25), rpy=(0, 0, 0.2))),
        )
        + gait
    )


def problem(motion):
    body, srb = quadruped()
    objective, limits, effort = terms()
    schedule = body.over(0.16, dt=0.01).without(effort) + srb.over(0.2, dt=0.05).without(limits)
    return ocp.Problem(motion, schedule, objective + effort, limits, initial=body.state(joints="stand"))


def assert_same(got, expected, tolerance):
    assert [(p.segment, p.number, p.name, p.mode, p.transition, p.resets) for p in got.parts] == [
        (p.segment, p.number, p.name, p.mode, p.transition, p.resets) for p in expected.parts
    ]
    assert (got.status, got.iterations) == (expected.status, expected.iterations)
    turn = got.anchor[2] - expected.anchor[2]
    assert np.allclose(got.anchor[:2], expected.anchor[:2], atol=1e-9)
    assert abs(np.sin(turn)) < 1e-9
    for own, other in zip(got.parts, expected.parts, strict=True):
        for name in (*TABLES, *RESULTS):
            a, b = getattr(own, name), getattr(other, name)
            scale = tolerance * (1 + np.abs(b).max(initial=0.0)) if name in RESULTS else 1e-9
            assert a.shape == b.shape
            assert np.abs(a - b).max(initial=0.0) < scale, (own.name, name)
        assert own.multipliers.keys() == other.multipliers.keys()
        for name, b in other.multipliers.items():
            scale = tolerance * (1 + np.abs(b).max(initial=0.0))
            assert np.abs(own.multipliers[name] - b).max(initial=0.0) < scale, (own.name, name)
    assert got.barrier_weight == expected.barrier_weight


def ahead(plan, t, rng, noise):
    """A state of the plan at a later time, in the world, with noise."""
    part = [p for p in plan.parts if p.times[0] <= t + 1e-9][-1]
    space = part.mode.state
    x = space.np_plus(part.states[round((t - part.times[0]) / 0.01)], noise * rng.standard_normal(space.ndx))
    return plan.world(x)


def make_equal(native, got, numpy, expected):
    """Give the next tick in C the inputs of the one in NumPy; without this, rounding errors grow from tick to tick."""
    for own, other in zip(got.parts, expected.parts, strict=True):
        own.states[:], own.controls[:], own.feedback[:] = other.states, other.controls, other.feedback
        for name, values in own.multipliers.items():
            values[:] = other.multipliers[name]
    native._native.memory.c.last_equality = numpy._numpy.outer.last_equality
    memory = numpy._numpy.course.memory
    native._native.memory.memory[: memory.size] = memory


MOTIONS = {
    "trot": lambda: models.gaits.trot(speed=0.4, yaw_rate=0.2, heading_limit=0.002),
    "bound": lambda: models.gaits.bound(speed=0.5, yaw_rate=0.3),
    "hop": lambda: hop_then(models.gaits.trot(speed=0.3)),
    "gaits": lambda: models.gaits.pace(speed=0.3, stance_time=0.1).cycles(1) + models.gaits.trot(speed=0.3),
}


ADAPTING = solvers.Adapting(min_weight=0.005, max_defect=10.0)


@pytest.mark.parametrize(("latency", "barrier"), [(0.0, None), (0.013, None), (0.013, ADAPTING)])
@pytest.mark.parametrize("name", MOTIONS)
def test_ticks_in_c_equal_those_in_numpy(name, latency, barrier):
    declared = problem(MOTIONS[name]())
    both = [
        solvers.RecedingHorizon(
            declared, iterations=1, latency=latency, first_iterations=6, backend=backend, barrier=barrier
        )
        for backend in ("native", "numpy")
    ]
    rng = np.random.default_rng(len(name))
    x, t = np.array(declared.initial), 0.0
    landed, kept = 0, []
    for k in range(24):
        if k == 10 and name == "trot":
            for each in both:
                each.command(speed=0.2, yaw_rate=0.5)
        got, expected = (each.plan(x, t) for each in both)
        assert_same(got, expected, 1e-8)
        memory = both[1]._numpy.course.memory
        assert both[0]._native.memory.memory[: memory.size] == pytest.approx(memory, abs=1e-9)
        kept += [memory[2]] if memory.size else []
        assert got.measured_at == t
        assert got.start >= t + latency - 1e-9
        landed += any(p.resets for p in got.parts)
        make_equal(both[0], got, both[1], expected)
        later = t + 0.02 if k % 3 else t + 0.017  # also off the grid of the model's steps
        x, t = ahead(expected, max(round(later, 2), expected.start), rng, 1e-3), later
    assert landed
    if name == "trot":  # the kept heading is sometimes at its limit, and sometimes within
        assert 0 < np.count_nonzero(np.abs(kept) > 0.002 - 1e-9) < len(kept) - 1
        for each in both:
            each.reset()
            each.plan(expected.world(expected.parts[0].states[0]), 0.0)
        for memory in (both[0]._native.memory.memory, both[1]._numpy.course.memory):
            assert memory[2] == pytest.approx(0.0, abs=1e-9)  # nothing is kept of the time before


def test_a_state_from_before_a_touchdown_is_taken_through_the_impact():
    declared = problem(hop_then(models.gaits.trot(speed=0.3)))
    body, _ = quadruped()
    mpc = solvers.RecedingHorizon(declared, first_iterations=1)
    x = np.array(declared.initial)
    x[19:25] = (0.3, 0.0, -0.8, 0.1, 0.2, 0.0)
    plan = mpc.plan(x, 0.22)  # the feet land at this time
    local = plan.local(x)
    after = body.impact(local, "FL FR HL HR")
    assert np.linalg.norm(after - local) > 0.5
    assert np.allclose(plan.parts[0].states[0], after, atol=1e-9)
    again = solvers.RecedingHorizon(declared, first_iterations=1).plan(plan.world(after), 0.22)
    assert np.allclose(again.parts[0].states[0], again.local(plan.world(after)), atol=1e-6)


def test_the_prediction_is_what_the_model_does_under_the_plan():
    declared = problem(models.gaits.trot(speed=0.4))
    mpc = solvers.RecedingHorizon(declared, latency=0.02)
    first = mpc.plan(declared.initial, 0.0)
    assert first.start == pytest.approx(0.02)
    # on the plan the state is that of the plan, two steps later
    x = first.world(first.parts[0].states[0])
    second = mpc.plan(x, 0.02)
    assert second.start == pytest.approx(0.04)
    assert np.allclose(second.world(second.parts[0].states[0]), first.world(first.parts[0].states[2]), atol=1e-6)


def test_an_own_model_with_resets_and_without_frame():
    fall = {"fall": lambda s: {"z": s.vz, "vz": s.thrust - 9.81}}
    ball = ocp.Model("ball", state={"z": 1, "vz": 1}, control={"thrust": 1}, modes=fall)
    motion = ocp.Motion(
        ocp.Phase("drop", "fall", 0.45, until=ocp.equality(lambda s: s.z), reset=ocp.reset(lambda s: {"vz": -s.vz})),
        ocp.Phase("rise", "fall", 0.40, target={"z": 0.6}),
    )
    objective = ocp.Objective(ocp.track("z", weight=1000.0, at="end"), ocp.regularize("thrust", weight=0.1))
    limit = ocp.Constraints(ocp.inequality(lambda s: s.thrust, lower=-5.0, upper=5.0, name="thrust"))
    declared = ocp.Problem(motion, ball.over(0.3, dt=0.01), objective, limit, initial=[1.0, 0.0])
    both = [solvers.RecedingHorizon(declared, backend=backend) for backend in ("native", "numpy")]
    x, rng = np.array([1.0, 0.0]), np.random.default_rng(0)
    for k in range(42):
        got, expected = (each.plan(x, 0.02 * k) for each in both)
        assert_same(got, expected, 1e-8)
        assert got.anchor == (0.0, 0.0, 0.0)
        x = ahead(expected, 0.02 * k + 0.02, rng, 1e-3) if k < 41 else x
    with pytest.raises(ProblemError, match=r"time is outside the motion - got t = 0.85 s, expected 0 ≤ t ≤ 0.84 s"):
        both[0].plan(x, 0.85)


def test_plans_keep_their_numbers_and_memory_is_used_again():
    declared = problem(models.gaits.trot(speed=0.4))
    mpc = solvers.RecedingHorizon(declared, first_iterations=2, iterations=1)
    kept = [mpc.plan(declared.initial, 0.02 * k) for k in range(3)]
    states = [plan.parts[0].states.copy() for plan in kept]
    for k in range(3, 40):
        mpc.plan(declared.initial, 0.02 * k)
    assert all(np.array_equal(plan.parts[0].states, x) for plan, x in zip(kept, states, strict=True))
    gc.collect()
    assert len(mpc._native.pool) <= 2  # those of plans that nobody keeps


def test_an_array_keeps_its_numbers_without_its_plan():
    declared = problem(models.gaits.trot(speed=0.4))
    mpc = solvers.RecedingHorizon(declared, first_iterations=2, iterations=1)
    states = mpc.plan(declared.initial, 0.0).parts[0].states
    before = states.copy()
    for k in range(1, 10):
        mpc.plan(declared.initial, 0.02 * k)
    assert np.array_equal(states, before)


def test_the_frame_of_a_plan_is_that_of_its_anchor():
    declared = problem(models.gaits.trot(speed=0.4))
    mpc = solvers.RecedingHorizon(declared, first_iterations=1)
    space, rng = mpc.horizon.models[0].state, np.random.default_rng(5)
    x = mpc.horizon.courses.moved(np.array(declared.initial), (2.0, -1.0, 2.0))
    plan = mpc.plan(x, 0.0)
    for _ in range(20):
        y = space.np_plus(x, rng.standard_normal(space.ndx))
        assert np.allclose(plan.local(y), ocp.transform_state(space, y, ocp.relative(ocp.ORIGIN, plan.anchor)))
        assert np.allclose(plan.world(plan.local(y)), y)


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_the_budget_holds_for_plans_after_the_first(backend):
    declared = problem(models.gaits.trot(speed=0.4))
    mpc = solvers.RecedingHorizon(declared, budget_s=1e-9, first_iterations=3, backend=backend)
    first = mpc.plan(declared.initial, 0.0)
    assert first.iterations == 3
    assert first.status is solvers.Status.ITERATION_LIMIT
    second = mpc.plan(declared.initial, 0.02)
    assert second.iterations == 0
    assert second.status is solvers.Status.TIME_LIMIT


def test_reset_makes_the_first_plan_again():
    declared = problem(models.gaits.trot(speed=0.4))
    mpc = solvers.RecedingHorizon(declared)
    first = mpc.plan(declared.initial, 0.0)
    mpc.command(speed=0.1)
    mpc.plan(declared.initial, 0.02)
    mpc.reset()
    again = mpc.plan(declared.initial, 0.0)
    assert again.iterations == first.iterations > 4
    assert all(np.array_equal(a.states, b.states) for a, b in zip(first.parts, again.parts, strict=True))


def test_a_plan_is_followed_by_the_low_level_in_its_own_frame():
    declared = problem(models.gaits.trot(speed=0.4))
    plans = []
    for frame in ((0.0, 0.0, 0.0), (2.0, -1.0, 2.0)):
        mpc = solvers.RecedingHorizon(declared)
        x = mpc.horizon.courses.moved(np.array(declared.initial), frame)
        plan = mpc.plan(x, 0.0)
        low = solvers.Vwbc(plan)
        plans.append((low.control(x, 0.004), solvers.Vwbc(plan, backend="numpy").control(x, 0.004)))
    (here, here_numpy), (there, there_numpy) = plans
    assert np.allclose(here, there, atol=1e-8)
    assert np.allclose(here, here_numpy, atol=1e-8)
    assert np.allclose(there, there_numpy, atol=1e-8)


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"period": 0.015}, SolverError, r"period is out of range - got 0.015 s, expected a multiple"),
        ({"period": 0.0}, SolverError, r"period is out of range - got 0 s"),
        ({"period": float("nan")}, SolverError, r"period is out of range - got nan s"),
        ({"latency": -0.01}, SolverError, r"latency is out of range - got -0.01 s"),
        ({"latency": 0.03}, SolverError, r"latency is out of range - got 0.03 s, expected 0 to the period, 0.02 s"),
        ({"iterations": 2.5}, SolverError, r"iterations is out of range - got 2.5, expected a whole number"),
        ({"iterations": 0}, SolverError, r"iterations is out of range - got 0"),
        ({"budget_s": 0.0}, SolverError, r"time_limit_s is out of range|budget_s is out of range"),
        ({"backend": "fortran"}, SolverError, r"backend is unknown - got 'fortran'"),
    ],
)
def test_arguments_are_checked(arguments, error, text):
    with pytest.raises(error, match=text):
        solvers.RecedingHorizon(problem(models.gaits.trot()), **arguments)


def test_calls_are_checked():
    mpc = solvers.RecedingHorizon(problem(models.gaits.trot()), first_iterations=1)
    x = np.array(mpc.initial)
    with pytest.raises(ShapeError, match=r"got shape \(36,\), expected \(37,\)"):
        mpc.plan(x[1:], 0.0)
    with pytest.raises(ProblemError, match=r"got inf in 'base.position z'"):
        mpc.plan(np.r_[x[:2], np.inf, x[3:]], 0.0)
    with pytest.raises(ProblemError, match=r"time is outside the motion"):
        mpc.plan(x, -0.5)
    with pytest.raises(UnknownNameError, match=r"no command 'sped'"):
        mpc.command(sped=1.0)
    later = mpc.plan(x, 0.5)
    for t in (0.1, 0.49):
        with pytest.raises(ProblemError, match=r"time goes back"):
            mpc.plan(x, t)
    assert later.start == 0.5
