"""The tick in C and its twin in NumPy return the same."""

import threading

import numpy as np
import pytest

from piaffe import ocp, solvers
from piaffe.codegen import NoCompilerError
from piaffe.errors import SolverError
from piaffe.solvers import JointPD, QpStatus, SolvedPlan, Vwbc
from piaffe.solvers.tracking import native
from tests.problems import bouncing_ball, swing_up
from tests.solvers.tracking.test_tracking import OneStage, bounded, pushed, solved, standing, two_forces


def pair(plan, **options):
    twins = Vwbc(plan, **options), Vwbc(plan, backend="numpy", **options)
    assert [each.backend for each in twins] == ["native", "numpy"]
    return twins


def compare(twins, x, t, *contacts):
    compiled, readable = twins
    u, expected = compiled.control(x, t, *contacts), readable.control(x, t, *contacts)
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-9 * (1 + np.abs(expected).max()))
    assert (compiled.last is None) == (readable.last is None)
    if readable.last is not None and np.isfinite(x).all():
        one, other = compiled.last, readable.last
        assert (one.status, one.iterations, one.active) == (other.status, other.iterations, other.active)
        assert one.excess == pytest.approx(other.excess, rel=1e-9, abs=1e-9)
    for name in ("ticks", "damped", "statuses", "iterations", "fallbacks", "relaxed"):
        assert getattr(compiled, name) == getattr(readable, name), name


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"leave_out": ("base.position x", "base.position y"), "slots": {"gamma": 20.0}},
        {"gains": JointPD((3, 4, 5) * 4, 0.5), "step_feedforward": False},
    ],
)
def test_a_thousand_ticks_of_a_robot(options):
    _, compiled, x, u = standing()
    twins = pair(OneStage(compiled, x, u, Q_u=np.linspace(-1, 1, 12)), **options)
    sizes = np.random.default_rng(5).uniform(-1.5, 1.3, 1000)
    for seed, size in enumerate(10.0**sizes):
        state = pushed(compiled, x, size, seed)
        state[:2] += 0.1 * size
        compare(twins, state, 0.0)
    for flags in ((0, 0, 0, 0), (1, 1, 1, 1), (0, 1, 0, 1)):
        for each in twins:
            each.measure({"contact": flags, "gamma": 5.0})
        for seed in range(50):
            compare(twins, pushed(compiled, x, 0.2, seed), 0.0)
    assert set(twins[0].statuses) == {QpStatus.SOLVED, QpStatus.RELAXED}
    assert twins[0].statuses[QpStatus.SOLVED] > 500
    assert max(twins[0].iterations) > 10


@pytest.mark.parametrize("make", [bounded, bouncing_ball, swing_up])
def test_ticks_between_the_nodes_of_several_phases(make):
    compiled, solution = solved(make)
    twins, rng = pair(SolvedPlan(solution, compiled)), np.random.default_rng(0)
    start, end = solution.trajectory.phases[0].times[0], solution.trajectory.phases[-1].times[-1]
    nodes = np.concatenate([phase.times for phase in solution.trajectory.phases])
    for t in (*rng.uniform(start - 0.1, end + 0.1, 300), *nodes, *(nodes - 1e-9), *(nodes + 1e-9)):
        planned = solution.policy.planned(t)
        delta = 10.0 ** rng.uniform(-3, 1) * rng.standard_normal(planned.part.state.ndx)
        compare(twins, planned.part.state.np_plus(planned.state, delta), t)


def test_rows_that_are_not_affine_and_equalities():
    problem = two_forces(
        ocp.equality(lambda s: s.force[0] - 2 * s.force[1] - s.speed, name="share"),
        ocp.inequality(lambda s: 9.0 - s.force[0] ** 2, lower=0.0, name="square"),
        ocp.inequality(lambda s: s.force[1], upper=3.0, name="bound"),
    )
    compiled = ocp.compile_problem(problem)
    solution = solvers.MSiLQR(compiled, backend="numpy").solve().raise_if_failed()
    twins, rng = pair(SolvedPlan(solution, compiled)), np.random.default_rng(0)
    for t in rng.uniform(0.0, 0.3, 200):
        compare(twins, 10.0 ** rng.uniform(-2, 0.5) * rng.standard_normal(2), t)
    assert twins[0].statuses[QpStatus.SOLVED] > 50


def test_bad_numbers():
    _, compiled, x, u = standing()
    twins = pair(OneStage(compiled, x, u), damping=0.7)
    for i in range(len(x)):
        state = pushed(compiled, x, 5.0, i)
        state[i] = (np.nan, np.inf, -np.inf)[i % 3]
        compare(twins, state, 0.0)
    assert twins[0].damped == len(x)
    for name, size in (("Q_u", (12,)), ("Q_uu", (12, 12)), ("feedback", (12, 36)), ("Q_ux", (12, 36))):
        compare(pair(OneStage(compiled, x, u, **{name: np.full(size, np.nan)})), pushed(compiled, x, 0.1), 0.0)
    compare(pair(OneStage(compiled, x, u, Q_uu=-np.eye(12))), x, 0.0)


def test_controllers_in_two_threads_do_not_disturb_each_other():
    _, compiled, x, u = standing()
    states = [pushed(compiled, x, 0.3, seed) for seed in range(50)]
    reference = Vwbc(OneStage(compiled, x, u))
    expected = [reference.control(state, 0.0) for state in states]
    wrong = []

    def run():
        own = Vwbc(OneStage(compiled, x, u))
        for _ in range(20):
            wrong.extend(i for i, state in enumerate(states) if (own.control(state, 0.0) != expected[i]).any())

    threads = [threading.Thread(target=run) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_without_a_compiler_the_tick_is_in_numpy(monkeypatch):
    def none(*_, **__):
        raise NoCompilerError("no compiler")

    native._library.cache_clear()
    monkeypatch.setattr(native, "build", none)
    _, compiled, x, u = standing()
    controller = Vwbc(OneStage(compiled, x, u))
    assert controller.backend == "numpy"
    assert np.isfinite(controller.control(x, 0.0)).all()
    assert Vwbc(OneStage(compiled, x, u), qp="numpy").backend == "numpy"


def test_an_unknown_backend_is_named():
    _, compiled, x, u = standing()
    with pytest.raises(SolverError, match="Vwbc: backend is unknown - got 'c', expected 'native' or 'numpy'"):
        Vwbc(OneStage(compiled, x, u), backend="c")
