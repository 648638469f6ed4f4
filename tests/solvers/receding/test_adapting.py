"""A barrier that adapts between ticks: what becomes of rows, what the next plan keeps of them, and what is refused."""

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import SolverError

from ...problems import LIMIT, WEIGHT, WISH, pulling
from .test_ticks import problem

BACKENDS = pytest.mark.parametrize("backend", ["native", "numpy"])
STAGE = ("equality", "penalty", "relaxation", "shift")


def dropping() -> ocp.Problem:
    """A ball has to be on the ground at a time, later than it would fall."""
    fall = {"fall": lambda s: {"z": s.vz, "vz": s.thrust - 9.81}}
    ball = ocp.Model("ball", state={"z": 1, "vz": 1}, control={"thrust": 1}, modes=fall)
    motion = ocp.Motion(
        ocp.Phase("drop", "fall", 0.6, until=ocp.equality(lambda s: s.z), reset=ocp.reset(lambda s: {"vz": -s.vz})),
        ocp.Phase("rise", "fall", 0.4, target={"z": 0.6}),
    )
    objective = ocp.Objective(ocp.track("z", weight=1.0, at="end"), ocp.regularize("thrust", weight=1.0))
    return ocp.Problem(motion, ball.until_end(dt=0.02), objective, initial=[1.0, 0.0])


def planner(declared, barrier, backend, penalty=10.0):
    options = solvers.Options(penalty=penalty, cost_tolerance=1e-12)
    return solvers.RecedingHorizon(declared, period=0.1, barrier=barrier, options=options, backend=backend)


@BACKENDS
def test_a_row_at_its_bound_gets_the_relaxation_of_its_multiplier(backend):
    fixed = planner(pulling(), solvers.Fixed(0.05, 0.1), backend)
    adapting = planner(pulling(), solvers.Adapting(0.05, 0.1), backend)
    for _ in range(12):
        kept, plan = (mpc.plan([0.0], 0.0) for mpc in (fixed, adapting))
    multiplier = WEIGHT * (WISH - kept.parts[0].controls[0, 0])
    assert kept.max_inequality == pytest.approx(multiplier * 0.1**2 / 0.05 - 2 * 0.1)  # 0.6 N
    assert plan.max_inequality < 1e-4
    needed = 2 * 0.05 / (WEIGHT * (WISH - LIMIT))
    relaxation = plan.parts[0].multipliers["relaxation"]
    assert np.all((0.7 * needed < relaxation) & (relaxation < 1.01 * needed))
    assert not plan.parts[0].multipliers["shift"].any()
    assert plan.barrier_weight == 0.05


@BACKENDS
def test_a_row_that_would_be_too_stiff_is_shifted(backend):
    mpc = planner(pulling(), solvers.Adapting(0.05, 0.1, max_stiffness=50.0), backend)
    for _ in range(40):
        plan = mpc.plan([0.0], 0.0)
    assert plan.max_inequality < 1e-4
    assert plan.parts[0].multipliers["relaxation"] == pytest.approx(np.sqrt(0.05 / 50.0))
    assert plan.parts[0].multipliers["shift"].min() > 1e-3


@BACKENDS
def test_the_weight_decreases_to_the_smallest(backend):
    mpc = planner(pulling(), solvers.Adapting(0.05, 0.1, min_weight=0.001), backend)
    weights = [mpc.plan([0.0], 0.0).barrier_weight for _ in range(12)]
    assert weights == sorted(weights, reverse=True)
    assert weights[-1] == 0.001
    assert mpc.plan([0.0], 0.0).max_inequality < 1e-4


@BACKENDS
def test_a_touchdown_s_multiplier_takes_up_penalty_times_violation(backend):
    fixed = planner(dropping(), None, backend)
    adapting = planner(dropping(), solvers.Adapting(max_penalty=10.0), backend)
    first = adapting.plan([1.0, 0.0], 0.0)
    multiplier = first.parts[0].multipliers["end_equality"]
    assert first.max_equality > 0.01
    assert abs(multiplier[0]) == pytest.approx(10.0 * first.max_equality)
    assert multiplier[0] == pytest.approx(10.0 * first.parts[0].states[-1, 0])
    violations = [adapting.plan([1.0, 0.0], 0.0).max_equality for _ in range(40)]
    assert violations[-1] < 1e-4
    for _ in range(5):
        kept = fixed.plan([1.0, 0.0], 0.0)
    assert kept.max_equality == pytest.approx(first.max_equality)
    assert kept.parts[0].multipliers == {}


@BACKENDS
def test_penalties_increase_up_to_the_largest_if_a_violation_decreases_slowly(backend):
    mpc = planner(dropping(), solvers.Adapting(max_penalty=30.0), backend, penalty=1.0)
    found = [mpc.plan([1.0, 0.0], 0.0).parts[0].multipliers["end_penalty"][0] for _ in range(6)]
    assert found[0] == 1.0  # nothing to compare with
    assert 5.0 in found
    assert found[-1] == 30.0


@BACKENDS
def test_reset_forgets_them(backend):
    mpc = planner(dropping(), solvers.Adapting(), backend)
    first = mpc.plan([1.0, 0.0], 0.0)
    mpc.plan([1.0, 0.0], 0.0)
    mpc.reset()
    again = mpc.plan([1.0, 0.0], 0.0)
    for name, values in first.parts[0].multipliers.items():
        np.testing.assert_array_equal(again.parts[0].multipliers[name], values)


@BACKENDS
def test_a_plan_whose_defects_are_large_changes_nothing(backend):
    declared = problem(models.gaits.bound(speed=0.5))
    for limit, changes in ((1e-9, False), (1e3, True)):
        mpc = solvers.RecedingHorizon(
            declared, barrier=solvers.Adapting(max_defect=limit), first_iterations=1, backend=backend
        )
        plan = mpc.plan(declared.initial, 0.2)  # feet land within the horizon
        assert 1e-9 < plan.max_defect < 1e3
        changed = any((part.multipliers["relaxation"] < 0.1).any() for part in plan.parts)
        changed |= any(part.multipliers["end_equality"].any() for part in plan.parts)
        assert changed == changes


def test_rows_keep_their_numbers_by_time_and_new_ones_begin_with_the_first():
    declared = problem(models.gaits.bound(speed=0.5))
    mpc = solvers.RecedingHorizon(declared, barrier=solvers.Adapting(max_defect=1e3))
    last = mpc.plan(declared.initial, 0.0)
    for k in range(1, 18):
        last = mpc.plan(ahead(last, 0.02 * k), 0.02 * k)
    mpc._native.memory.c.options.time_limit_s = 1e-12  # no step, so that nothing adapts
    plan = mpc.plan(ahead(last, 0.36), 0.36)
    assert plan.iterations == 0
    first = {"equality": 0.0, "penalty": 1000.0, "relaxation": 0.1, "shift": 0.0}
    seen = {"kept": 0, "changed": 0, "new": 0, "ends": 0}
    for part in plan.parts[:-1]:
        before = [p for p in last.parts if (p.number, p.mode) == (part.number, part.mode)]
        rows = {round(t, 6): (p, j) for p in before for j, t in enumerate(p.times[:-1])}
        for k, t in enumerate(part.times[:-1]):
            found = rows.get(round(t, 6))
            for name in STAGE:
                expected = first[name] if found is None else found[0].multipliers[name][found[1]]
                assert np.all(part.multipliers[name][k] == expected)
            seen["new" if found is None else "kept"] += 1
            seen["changed"] += found is not None and bool((found[0].multipliers["relaxation"][found[1]] < 0.1).any())
        for p in before:
            if abs(p.times[-1] - part.times[-1]) < 1e-6 and p.transition is part.transition:
                seen["ends"] += 1
                for name in STAGE:
                    np.testing.assert_array_equal(part.multipliers[f"end_{name}"], p.multipliers[f"end_{name}"])
    assert min(seen.values()) > 0, seen


def ahead(plan, t):
    """The plan's state at a time, in the world."""
    part = [p for p in plan.parts if p.times[0] <= t + 1e-9][-1]
    return plan.world(part.states[round((t - part.times[0]) / 0.01)])


def test_a_loop_keeps_them_too():
    declared = problem(models.gaits.trot(speed=0.4))
    mpc = solvers.RecedingHorizon(declared, barrier=solvers.Adapting(max_defect=1e3), latency=0.02)
    other = solvers.RecedingHorizon(declared, barrier=solvers.Adapting(max_defect=1e3), latency=0.02)
    x = np.array(declared.initial)
    expected = [other.plan(x, t) for t in (0.0, 0.02, 0.04)][-1]
    low = solvers.Vwbc(mpc.plan(x, 0.0))
    with mpc.running(low, thread=False) as loop:
        for k in range(1, 32):
            loop.control(x, 0.002 * k)
        found = loop.plan
    assert found.measured_at == pytest.approx(expected.measured_at)
    for part, own in zip(found.parts, expected.parts, strict=True):
        for name, values in own.multipliers.items():
            np.testing.assert_allclose(part.multipliers[name], values, rtol=1e-9)


@pytest.mark.parametrize("name", ["weight", "relaxation", "min_weight", "max_stiffness", "max_penalty", "max_defect"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_numbers_out_of_range_are_named(name, value):
    with pytest.raises(SolverError, match=rf"adapting barrier: {name} is out of range - got .*, expected a positive"):
        solvers.Adapting(**{name: value})


def test_numbers_that_contradict_each_other_are_named():
    with pytest.raises(SolverError, match=r"min_weight is out of range - got 0.1, expected at most the weight, 0.05"):
        solvers.Adapting(0.05, 0.1, min_weight=0.1)
    with pytest.raises(SolverError, match=r"max_penalty is out of range - got 10.0, expected at least .* 1000"):
        solvers.RecedingHorizon(pulling(), period=0.1, barrier=solvers.Adapting(max_penalty=10.0))


def test_options_are_those_of_the_barrier():
    options = solvers.Adapting(0.3, 0.2, max_penalty=500.0).options(solvers.Options(penalty=7.0))
    assert (options.barrier_weight, options.relaxation, options.min_barrier_weight) == (0.3, 0.2, 0.3)
    assert (options.penalty, options.max_penalty, options.adapt) == (7.0, 500.0, False)
