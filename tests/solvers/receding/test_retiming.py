"""Retiming: the clock of the motion follows the predicted landing, the same in C and in NumPy."""

from functools import lru_cache
from math import sqrt

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ProblemError, SolverError
from piaffe.simulation import Plant, Push, run_online

from .test_ticks import ahead, assert_same, hop_then, make_equal, problem, quadruped

UP = 21  # vertical velocity of the base in the state


def hop():
    return problem(hop_then(models.gaits.trot(speed=0.3)))


def centre(horizon, x):
    """Height, vertical speed and gravity of the centre of mass."""
    ((mode, function),) = horizon.falls.functions.items()
    p = next(store.rows[0] for store in horizon.tables.modes if store.lowered is mode)
    return function(x, p).full().ravel()


@lru_cache(maxsize=1)
def planned():
    """States of a hop without retiming, by time [s]."""
    mpc = solvers.RecedingHorizon(hop())
    x, now, states = np.array(mpc.initial), 0.0, {}
    while now < 0.2:
        plan = mpc.plan(x, now)
        now = round(now + 0.02, 2)
        states[now] = x = ahead(plan, now, np.random.default_rng(0), 0.0)
    return states


def in_flight(t, faster):
    """A state in flight at a time [s], that rises faster than planned [m/s]."""
    x = planned()[t].copy()
    x[UP] += faster
    return x


def test_the_flights_of_a_motion_and_the_heights_of_their_landings():
    horizon = ocp.Horizon(hop())
    heights = dict(zip((e.phase.name for e in horizon.calendar.entries[:3]), horizon.falls.heights[:3], strict=True))
    assert np.isnan([heights["push"], heights["land"]]).all()
    model = horizon.models[0]
    sample = horizon._compilation.path.sample(0.22, horizon._compilation.path.interval_before(0.22))
    x = model.state.np_normalise(model.state.pack({b.quantity: sample[b.quantity] for b in model.state.blocks}))
    assert heights["air"] == pytest.approx(centre(horizon, x)[0], abs=1e-12)
    trot = ocp.Horizon(problem(models.gaits.trot(speed=0.4)))
    assert np.isnan(trot.falls.heights).all()  # no flight
    assert not trot.falls.functions


@pytest.mark.parametrize("faster", [-0.15, -0.1, 0.1, 0.3])
def test_the_clock_is_late_by_the_landing_in_closed_form(faster):
    mpc = solvers.RecedingHorizon(hop(), retiming=solvers.Retiming(limit=0.2, gain=1.0))
    x = in_flight(0.18, faster)
    z, v, g = centre(mpc.horizon, x)
    rest = (v + sqrt(v * v + 2 * g * (z - mpc.horizon.falls.heights[1]))) / g
    plan = mpc.plan(x, 0.18)
    assert plan.shift == pytest.approx(np.floor((rest - 0.04) / 0.01 + 0.5) * 0.01, abs=1e-12)
    assert plan.start == pytest.approx(0.18)  # by the clock of the world
    landing = plan.parts[0].times[-1]
    assert landing == pytest.approx(0.22 + plan.shift)
    assert abs(landing - (0.18 + rest)) <= 0.005 + 1e-9
    assert plan.phases[1].times[0] == landing  # what a low level follows, and its flags
    assert plan.phases[1].times[-1] == pytest.approx(plan.parts[1].times[-1])


def test_the_shift_is_filtered_bounded_and_kept():
    mpc = solvers.RecedingHorizon(hop(), retiming=solvers.Retiming(limit=0.03, gain=0.5))
    x = in_flight(0.14, 0.6)
    shifts = []
    for t in (0.14, 0.16, 0.18):
        plan = mpc.plan(x, t)
        shifts.append(plan.shift)
        x = ahead(plan, round(t + 0.02, 2), np.random.default_rng(0), 0.0)
        x[UP] += 0.3
    assert shifts == pytest.approx([0.02, 0.02, 0.03])  # half of 0.03, rounded up; three quarters; seven eighths
    t = 0.2
    while plan.parts[0].name != "land":
        plan = mpc.plan(x, t)
        t = round(t + 0.02, 2)
        x = ahead(plan, t, np.random.default_rng(0), 0.0)
    assert plan.shift == pytest.approx(0.03)
    mpc.reset()
    assert mpc.plan(mpc.initial, 0.0).shift == 0


def test_a_landing_that_is_due_now_begins_the_next_phase():
    mpc = solvers.RecedingHorizon(hop(), retiming=solvers.Retiming(limit=0.2, gain=1.0))
    x = in_flight(0.18, -2.0)
    plan = mpc.plan(x, 0.18)
    assert plan.parts[0].name == "land"
    assert plan.shift == pytest.approx(-0.04)
    assert plan.start == pytest.approx(0.18)
    body, _ = quadruped()
    assert np.allclose(plan.parts[0].states[0], body.impact(plan.local(x), "FL FR HL HR"), atol=1e-9)


@pytest.mark.parametrize(("latency", "barrier"), [(0.0, None), (0.013, None), (0.0, solvers.Adapting(max_defect=10.0))])
def test_clocks_in_c_equal_those_in_numpy(latency, barrier):
    retiming = solvers.Retiming(limit=0.05, gain=0.7)
    both = [
        solvers.RecedingHorizon(
            hop(),
            iterations=1,
            latency=latency,
            first_iterations=6,
            backend=backend,
            retiming=retiming,
            barrier=barrier,
        )
        for backend in ("native", "numpy")
    ]
    rng = np.random.default_rng(4)
    x, t, shifts = np.array(both[0].initial), 0.0, set()
    for k in range(20):
        got, expected = (each.plan(x, t) for each in both)
        assert got.shift == pytest.approx(expected.shift, abs=1e-12)
        assert_same(got, expected, 1e-8)
        make_equal(both[0], got, both[1], expected)
        shifts.add(round(got.shift, 3))
        later = t + 0.02 if k % 3 else t + 0.017
        x, t = ahead(expected, max(round(later, 2), expected.start), rng, 1e-3), later
        if 0.12 < t < 0.2:
            x[UP] += 0.15 * rng.choice([-1.0, 2.0])
    assert len(shifts) > 2


def test_without_retiming_the_clock_is_the_world_s():
    assert solvers.RecedingHorizon(hop()).plan(in_flight(0.14, 0.3), 0.14).shift == 0


def test_the_motion_does_not_go_back():
    mpc = solvers.RecedingHorizon(hop(), retiming=solvers.Retiming(limit=0.2, gain=1.0))
    first = mpc.plan(in_flight(0.14, 0.0), 0.14).shift
    assert first < -0.01
    plan = mpc.plan(in_flight(0.16, 1.0), 0.16)
    assert plan.shift == pytest.approx(first + 0.02)  # the motion stands still
    assert plan.parts[0].times[-1] == pytest.approx(0.22 + plan.shift)


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_a_plan_that_is_refused_leaves_the_clock_as_it_was(backend):
    mpc = solvers.RecedingHorizon(hop(), backend=backend, retiming=solvers.Retiming(limit=0.2, gain=1.0))
    calendar, landing = mpc.horizon.calendar, mpc.horizon.calendar.entries[2].start
    if backend == "native":  # the motion ends where the robot lands, so that a clock which is ahead leaves it
        clock, mpc._native.memory.tables.c.total = mpc._native.memory.c.clock, landing
        told = [(lambda name=name: getattr(clock, name)) for name in ("shift", "base", "flight", "late")]
    else:
        calendar.total = landing
        told = [(lambda name=name: getattr(mpc._numpy.clock, name)) for name in ("shift", "_base", "_flight", "_late")]
    before = [value() for value in told]
    with pytest.raises(ProblemError, match="time is outside the motion"):
        mpc.plan(in_flight(0.18, -2.0), 0.18)
    assert [value() for value in told] == before == [0, 0, -1, 0.0]
    assert mpc.plan(in_flight(0.18, 0.0), 0.18).start == pytest.approx(0.18)


@pytest.mark.parametrize(
    ("limit", "gain"), [(0.0, 0.5), (-1.0, 0.5), (np.inf, 0.5), (np.nan, 0.5), (0.1, 0.0), (0.1, 1.1)]
)
def test_numbers_out_of_range_are_named(limit, gain):
    with pytest.raises(SolverError, match=r"retiming: a number is out of range - got limit .*expected a limit > 0 s"):
        solvers.Retiming(limit=limit, gain=gain)


def test_a_hop_that_is_pushed_up_lands_later_in_a_simulation():
    declared = hop()
    body, _ = quadruped()
    mpc = solvers.RecedingHorizon(declared, retiming=solvers.Retiming(gain=1.0))
    low = solvers.Vwbc(mpc.plan(declared.initial, 0.0), leave_out=("base.position x", "base.position y"))
    push = Push(time=0.13, velocity=(0.0, 0.0, 0.3), duration=0.01, frame="world")
    episode = run_online(mpc, low, Plant(body.robot, friction=0.7), seconds=0.6, pushes=[push])
    assert episode.success
    assert low.plan.shift > 0.02
