"""The feedback and the feed-forward with gains tick in C as in NumPy."""

from dataclasses import replace

import numpy as np
import pytest

from piaffe.codegen import NoCompilerError
from piaffe.errors import ShapeError, SolverError
from piaffe.models import load
from piaffe.solvers import FeedforwardPD, JointPD, MeasuredContacts, Riccati, SolvedPlan, Vwbc
from piaffe.solvers.tracking import native
from tests.problems import bouncing_ball, swing_up
from tests.solvers.tracking.test_contacts import KD, Stages
from tests.solvers.tracking.test_tracking import OneStage, bounded, pushed, solved, standing

FOOT = load("mini_cheetah").foot_of_joint
EARLY = MeasuredContacts(0.003, 0.004, 0.015, 0.008)


def pair(make, plan, **options):
    twins = tuple(make(plan, backend=backend, **options) for backend in ("native", "numpy"))
    assert [each.backend for each in twins] == ["native", "numpy"]
    return twins


def compare(twins, x, t, *contacts):
    u, expected = (each.control(x, t, *contacts) for each in twins)
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-9 * (1 + np.abs(expected).max()))
    assert [(each.ticks, each.damped) for each in twins] == [(twins[0].ticks, twins[0].damped)] * 2


@pytest.mark.parametrize(
    ("make", "options"),
    [
        (Riccati, {}),
        (Riccati, {"leave_out": ("base.position x", "base.position y"), "damping": 0.3}),
        (Riccati, {"gains": JointPD(3.0, KD, 0.25, FOOT)}),
        (Riccati, {"gains": JointPD((3, 4, 5) * 4, 0.5), "contacts": "measured"}),
        (FeedforwardPD, {"kd": 5.0}),
        (FeedforwardPD, {"kp": 30.0, "kd": 9.0, "in_stance": 0.25, "contact_of": FOOT, "contacts": EARLY}),
    ],
)
def test_a_thousand_ticks_equal_those_of_the_twin(make, options):
    rng, (_, compiled, x, _) = np.random.default_rng(3), standing()
    plan = Stages(["".join(map(str, rng.integers(0, 2, 4))) for _ in range(60)])
    twins, limit = pair(make, plan, **options), load("mini_cheetah").torque_limit
    flags, t, at_limit = np.ones(4), 0.0, 0
    for tick in range(1000):
        t = 0.0 if tick == 600 else t + rng.choice([0.0, 1e-3, 2e-3])
        flags = np.where(rng.random(4) < 0.15, 1 - flags, flags)
        given = (tuple(flags),) if "contacts" in options else ()
        state = pushed(compiled, x, 10.0 ** rng.uniform(-2, 1), tick)
        compare(twins, state, t, *given)
        np.testing.assert_array_equal(*(each.in_contact for each in twins))
        at_limit += (np.abs(twins[0].control(state, t, *given)) > limit - 1e-9).any()
        twins[1].control(state, t, *given)
    assert at_limit > 50


@pytest.mark.parametrize("make", [bounded, bouncing_ball, swing_up])
def test_between_the_nodes_of_several_phases_the_feedback_is_that_of_the_policy(make):
    compiled, solution = solved(make)
    twins, rng = pair(Riccati, SolvedPlan(solution, compiled)), np.random.default_rng(0)
    end = solution.trajectory.phases[-1].times[-1]
    nodes = np.concatenate([phase.times for phase in solution.trajectory.phases])
    for t in (*rng.uniform(-0.1, end + 0.1, 300), *nodes, *(nodes - 1e-9), *(nodes + 1e-9)):
        planned = solution.policy.planned(t)
        delta = 10.0 ** rng.uniform(-3, 1) * rng.standard_normal(planned.part.state.ndx)
        compare(twins, planned.part.state.np_plus(planned.state, delta), t)


@pytest.mark.parametrize("make", [Riccati, FeedforwardPD])
def test_numbers_that_are_not_finite_leave_the_damping(make):
    _, compiled, x, u = standing()
    twins = pair(make, OneStage(compiled, x, u), damping=0.7)
    for i in range(len(x)):
        state = pushed(compiled, x, 5.0, i)
        state[i] = (np.nan, np.inf, -np.inf)[i % 3]
        compare(twins, state, 0.0)
    assert twins[0].damped == len(x)
    for name, size in (("feedback", (12, 36)), ("controls", (12,)), ("Q_u", (12,)), ("Q_uu", (12, 12))):
        plan = OneStage(compiled, x, u)
        plan.phases = (replace(plan.phases[0], **{name: np.full((1, *size), np.nan)}),)
        twins = pair(make, plan)
        compare(twins, pushed(compiled, x, 0.1), 0.0)
        assert twins[0].damped == (name == "controls" or (name == "feedback" and make is Riccati))


def test_another_plan_is_followed_without_a_copy():
    _, compiled, x, u = standing()
    twins = pair(Riccati, OneStage(compiled, x, u))
    other, state = OneStage(compiled, x, u + 1.0), pushed(compiled, x, 0.05)
    before, _ = (each.control(state, 0.0) for each in twins)
    for each in twins:
        each.follow(other)
    compare(twins, state, 0.0)
    assert np.abs(twins[0].control(state, 0.0) - before).max() > 0.1
    twins[1].control(state, 0.0)
    other.phases[0].controls[0] += 0.5
    compare(twins, state, 0.0)


def test_controllers_of_one_plan_share_their_code_and_not_their_law():
    _, compiled, x, u = standing()
    plan, state = OneStage(compiled, x, u, Q_u=np.linspace(-1, 1, 12)), pushed(compiled, x, 0.3)
    native._library.cache_clear()
    every = [make(plan) for make in (Vwbc, Riccati, FeedforwardPD)]
    assert native._library.cache_info().misses == 1
    found = [each.control(state, 0.0) for each in every]
    assert min(np.abs(found[i] - found[j]).max() for i, j in ((0, 1), (1, 2), (2, 0))) > 0.01


@pytest.mark.parametrize("make", [Riccati, FeedforwardPD])
def test_bad_arguments_are_named(make):
    _, compiled, x, u = standing()
    plan, name = OneStage(compiled, x, u), make.__name__
    with pytest.raises(SolverError, match=f"{name}: backend is unknown - got 'c', expected 'native' or 'numpy'"):
        make(plan, backend="c")
    for backend in ("native", "numpy"):
        with pytest.raises(ShapeError, match=rf"{name}: state has the wrong size - got shape \(3,\), expected \(37,\)"):
            make(plan, backend=backend).control(np.zeros(3), 0.0)
    low, bad = make(plan), OneStage(compiled, x, u)
    bad.phases = (replace(bad.phases[0], feedback=np.zeros((1, 12, 35))),)
    with pytest.raises(ShapeError, match="feedback: wrong size - got 420 numbers, expected 432 for 1 stages"):
        low.follow(bad)


@pytest.mark.parametrize("make", [Riccati, FeedforwardPD])
def test_without_a_compiler_they_tick_in_numpy(make, monkeypatch):
    _, compiled, x, u = standing()

    def none(*_, **__):
        raise NoCompilerError("no compiler")

    native._library.cache_clear()
    monkeypatch.setattr(native, "build", none)
    low = make(OneStage(compiled, x, u))
    assert (low.backend, low.compiled) == ("numpy", None)
    np.testing.assert_allclose(low.control(x, 0.0), u)
