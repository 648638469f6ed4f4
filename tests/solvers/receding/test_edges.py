"""What a receding horizon does at the edges: times, memory, states that are not finite, impacts that are due now."""

import gc
import weakref
from concurrent.futures import ThreadPoolExecutor
from ctypes import byref, c_long, c_size_t
from functools import lru_cache

import numpy as np
import pytest

from piaffe import PiaffeWarning, models, ocp, solvers
from piaffe.errors import ProblemError
from piaffe.models import base, joints, stance
from tests import balls

BACKENDS = ("native", "numpy")
THREE = (("a", 0.3, 1.0), ("b", 0.2, 0.8), ("c", 0.5, 1.2))


def motion(**more):
    return ocp.Motion(*(balls.phase(*each) for each in THREE), **more)


def planner(schedule=None, backend="native", **more):
    return solvers.RecedingHorizon(
        balls.problem(motion(), schedule or balls.ball().over(0.2, dt=0.01)), backend=backend, **more
    )


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("t", [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e17])
def test_a_time_that_is_no_time_is_refused(backend, t):
    declared = balls.problem(motion(cyclic=True), balls.ball().over(0.2, dt=0.01))
    mpc = solvers.RecedingHorizon(declared, backend=backend)
    with pytest.raises(ProblemError, match=r"time is outside the motion - got t = .*, expected 0 ≤ t ≤ 1e\+07 s"):
        mpc.plan([1.0, 0.0], t)


def needs(mpc, k):
    """Bytes of the solver's memory, numbers and entries of a plan that begins at tick k."""
    memory, found = mpc._native.memory, (c_size_t(), c_long(), c_long())
    memory.code.library.receding_sizes(byref(memory.c), c_long(k), *map(byref, found))
    return [each.value for each in found]


@pytest.mark.parametrize(
    ("lengths", "step", "tail"), [((25, 15, 16, 21), 20, 7), ((3, 4, 4), 20, 6), ((30, 1), 7, 9), ((1,), 10, 3)]
)
def test_memory_is_enough_for_cycles_that_are_no_whole_number_of_steps(lengths, step, tail):
    cyclic = ocp.Motion(*(balls.phase(f"p{i}", 0.01 * n) for i, n in enumerate(lengths)), cyclic=True)
    head, second = balls.ball("head", cut=False), balls.ball("tail")
    schedule = head.over(0.01 * step, dt=0.01 * step) + second.over(0.01 * tail, dt=0.01)
    mpc = solvers.RecedingHorizon(balls.problem(cyclic, schedule), period=0.01 * step)
    memory = mpc._native.memory
    most = np.max([needs(mpc, k) for k in range(0, 3000, step)], axis=0)
    assert memory.plan_memory().numbers.size >= most[1]
    assert memory.plan_memory().header.size >= most[2]
    assert memory.arena_bytes >= most[0]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("latency", [0.0, 0.02])
def test_plans_recover_from_states_without_a_finite_cost(backend, latency):
    mpc, x = planner(backend=backend, latency=latency), np.array([1.0, 0.0])
    first = mpc.plan(x, 0.0)
    with np.errstate(all="ignore"):
        lost = [mpc.plan([1e200, 1e250], 0.02 * k) for k in (1, 2)]
    assert lost[-1].status is solvers.Status.NOT_FINITE
    found = [mpc.plan(x, 0.02 * k) for k in (3, 4)]
    assert [plan.status for plan in found] == [first.status] * 2
    assert all(np.isfinite(part.states).all() for plan in found for part in plan.parts)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_plan_that_begins_anew_keeps_to_the_iterations_of_a_tick(backend):
    mpc = planner(backend=backend, iterations=2, first_iterations=50)
    mpc.plan([1.0, 0.0], 0.0)
    with np.errstate(all="ignore"):
        mpc.plan([1e200, 1e250], 0.02)
    assert mpc.plan([1.0, 0.0], 0.04).iterations <= 2


@pytest.mark.parametrize("backend", BACKENDS)
def test_without_a_policy_gains_are_zero(backend):
    root = ocp.residual(lambda s: ((s.z - 1.0) ** 2) ** 0.25)  # its slope at 1 is infinite
    for_root = balls.problem(motion(), balls.ball().over(0.2, dt=0.01), root.weighted(1.0, name="root"))
    mpc = solvers.RecedingHorizon(for_root, backend=backend, first_iterations=1)
    with np.errstate(all="ignore"):
        plan = mpc.plan([1.0, 0.0], 0.0)
    assert not plan.has_policy
    for name in ("feedforward", "feedback", "Q_x", "Q_u", "Q_xx", "Q_ux", "Q_uu"):
        assert all(np.all(getattr(part, name) == 0.0) for part in plan.parts), name


def test_an_interrupted_tick_leaves_the_memory_that_c_reads(monkeypatch):
    mpc, x = planner(), np.array([1.0, 0.0])
    memory, made = mpc._native.memory, []
    mpc.plan(x, 0.0)
    call, make = memory.plan, memory.plan_memory

    def interrupted(x, t, plan):
        call(x, t, plan)
        raise KeyboardInterrupt

    def counted():
        own = make()
        made.append(weakref.ref(own))
        return own

    monkeypatch.setattr(memory, "plan_memory", counted)
    monkeypatch.setattr(memory, "plan", interrupted)
    with pytest.raises(KeyboardInterrupt):
        mpc.plan(x, 0.02)
    monkeypatch.setattr(memory, "plan", call)
    gc.collect()
    kept = made[0]()
    assert kept is not None  # the next tick begins with its plan
    assert memory.c.last.numbers == kept.c.numbers
    assert mpc.plan(x, 0.04).status is solvers.Status.STATIONARY


def test_planners_in_two_threads_do_not_disturb_one_another():
    def run(z):
        mpc, x, found = planner(latency=0.013), np.array([z, 0.0]), []
        for k in range(30):
            plan = mpc.plan(x, 0.02 * k)
            found.append(plan.parts[0].states.copy())
            x = found[-1][1]
        return found

    heights = (0.9, 1.1)
    alone = [run(z) for z in heights]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(run, heights))
    for one, other in zip(alone, together, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("backend", BACKENDS)
def test_prediction_ends_where_another_model_begins_also_with_a_state_of_the_same_size(backend):
    def mode(s):
        return {"vz": s.thrust - 9.81, "z": s.vz}

    tail = ocp.Model("tail", state={"vz": 1, "z": 1}, control={"thrust": 1}, modes={"fall": mode})
    schedule = balls.ball("head").over(0.02, dt=0.01) + tail.over(0.1, dt=0.01)
    mpc = planner(schedule, backend, period=0.05, latency=0.05)
    first = mpc.plan([1.0, 0.2], 0.0)
    assert first.parts[1].mode.state.nx == 2
    x = first.parts[0].states[0]
    second = mpc.plan(x, 0.05)
    assert np.allclose(second.parts[0].states[0], first.parts[0].states[2], atol=1e-9)


@lru_cache(maxsize=1)
def body():
    return models.WholeBody(models.load("mini_cheetah"))


def landing(**more):
    """Stand, fly, stand; options of the flight."""
    stands = stance("FL FR HL HR")
    place = ocp.Keyframe(position=(0, 0, 0.27))
    flown = ocp.Motion(
        ocp.Phase("push", stands, 0.1, place), ocp.Phase("air", stance(""), 0.1, place, **more),
        ocp.Phase("land", stands, 0.3, place),
    )  # fmt: skip
    objective = ocp.Objective(
        ocp.track(base.position, weight=30.0), ocp.track(base.orientation, weight=5.0),
        ocp.track(joints.position, weight=1.0), ocp.regularize(joints.torque, weight=0.02),
    )  # fmt: skip
    return ocp.Problem(flown, body().over(0.12, dt=0.01), objective, initial=body().state(joints="stand"))


def moving(velocity):
    x = np.array(body().state(joints="stand"))
    x[body().state.slices[base.linear_velocity]] = velocity
    return x


@pytest.mark.parametrize("backend", BACKENDS)
def test_at_a_landing_with_a_reset_of_the_user_the_state_counts_as_after_both(backend):
    halved = ocp.reset(lambda s: {"base.linear_velocity": 0.5 * s.base.linear_velocity})
    mpc = solvers.RecedingHorizon(landing(reset=halved), first_iterations=1, backend=backend)
    x = moving((0.5, 0.0, -0.8))
    plan = mpc.plan(x, 0.2)
    assert np.allclose(plan.parts[0].states[0], plan.local(x), atol=1e-12)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_state_measured_at_a_touchdown_lands_before_it_is_predicted(backend):
    x = moving((0.1, 0.0, -0.6))
    landed = body().impact(x, "FL FR HL HR")
    starts = []
    for state in (x, landed):
        mpc = solvers.RecedingHorizon(landing(), first_iterations=2, latency=0.02, backend=backend)
        mpc.plan(x, 0.16)
        plan = mpc.plan(state, 0.2)
        starts.append(plan.world(plan.parts[0].states[0]))
    assert np.abs(x - landed).max() > 0.5
    assert np.allclose(*starts, atol=1e-6)


@pytest.mark.parametrize("backend", BACKENDS)
def test_likely_mistakes_are_named_before_the_first_plan(backend):
    short = ocp.Motion(balls.phase("blink", 0.02, 1.0), balls.phase("rest", 0.3, 1.0))
    schedule = balls.ball().over(0.2, dt=0.01)
    with pytest.warns(PiaffeWarning, match=r"phase 'blink' .*few steps - got 2 of 0\.01 s") as found:
        mpc = solvers.RecedingHorizon(balls.problem(short, schedule), backend=backend)
    assert [str(each.message) for each in found] == [str(each) for each in mpc.warnings]
    assert found[0].filename == mpc.warnings[0].source.file
    assert planner(backend=backend).warnings == []


def test_a_control_without_cost_is_refused_before_the_first_plan():
    declared = balls.problem(motion(), balls.ball().over(0.2, dt=0.01))
    objective = ocp.Objective(ocp.track("z", weight=1.0))
    free = ocp.Problem(declared.motion, declared.schedule, objective, initial=declared.initial)
    with pytest.raises(ProblemError, match=r"phase 'a' .*: a control has no running cost - got none on 'thrust'"):
        solvers.RecedingHorizon(free)
