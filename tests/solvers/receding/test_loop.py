"""Loops: plans of a thread equal those made one by one; what is missed, what fails, and that no thread is left."""

import ctypes as ct
import gc
import subprocess
import sys
import threading
import time
from functools import lru_cache

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ProblemError, ShapeError, SolverError
from piaffe.solvers.receding import loop_memory
from piaffe.solvers.receding.memory import NOT_FINITE_PLAN
from piaffe.solvers.tracking import contacts_at
from tests.solvers.receding.test_ticks import problem

TICK, PERIOD = 0.002, 0.02
LIMIT = 30.0  # [s], for tests that would else wait for ever


@lru_cache(maxsize=1)
def trot():
    return problem(models.gaits.trot(speed=0.4))


def robot(latency=PERIOD, declared=None, make=solvers.Vwbc, **options):
    """Return a receding horizon and a low level that follows its first plan."""
    mpc = solvers.RecedingHorizon(declared or trot(), first_iterations=3, iterations=1, latency=latency)
    return mpc, make(mpc.plan(mpc.initial, 0.0), **options)


def mass(seconds=4.0):
    """A mass on a rail, which is driven to a place."""
    rail = ocp.Model(
        "mass", state={"place": 1, "speed": 1}, control={"force": 1},
        modes={"slide": lambda s: {"place": s.speed, "speed": s.force}},
    )  # fmt: skip
    objective = ocp.Objective(ocp.track("place", 20.0), ocp.track("speed", 1.0), ocp.regularize("force", 0.1))
    limits = ocp.Constraints(ocp.inequality(lambda s: s.force, lower=-5, upper=5, name="force", unit="N"))
    motion = ocp.Motion(ocp.Phase("slide", "slide", seconds, target={"place": 1.0}))
    return ocp.Problem(motion, rail.over(0.2, dt=0.02), objective, limits, initial=[0.0, 0.0])


def measured(mpc, ticks, seed=0):
    """Return states near the first one."""
    space, rng = mpc.horizon.models[0].state, np.random.default_rng(seed)
    return [space.np_plus(mpc.initial, 1e-3 * rng.standard_normal(space.ndx)) for _ in range(ticks)]


def settle(loop):
    """Wait until no plan is being made."""
    end = time.monotonic() + LIMIT
    while loop.is_planning:
        assert time.monotonic() < end
        time.sleep(1e-4)


def run(loop, states, first=0, *, flags=None):
    """Return the controls of ticks; each plan is complete before the next tick."""
    found = []
    for k, x in enumerate(states[first:], first):
        found.append(loop.control(x, TICK * k, *(() if flags is None else (flags[k],))))
        settle(loop)
    return np.array(found)


def by_hand(mpc, low, states, commands, flags=None):
    """Return the controls of the same ticks with a plan made and followed in Python."""
    found, waits = [], None
    for k, x in enumerate(states):
        t = TICK * k
        if waits is not None and waits.start <= t + 1e-7:
            low.follow(waits)
            waits = None
        if t in commands:
            mpc.command(**commands[t])
        if k and k % 10 == 0:
            waits = mpc.plan(x, t)
            if waits.start <= t + 1e-7:
                low.follow(waits)
                waits = None
        found.append(low.control(x, t, *(() if flags is None else (flags[k],))))
    return np.array(found)


# ---- the same as by hand


@pytest.mark.parametrize(("latency", "thread"), [(0.02, True), (0.013, True), (0.013, False), (0.0, False)])
def test_a_loop_does_what_plans_and_ticks_do_that_are_made_by_hand(latency, thread):
    commands = {TICK * 30: {"speed": 0.2, "yaw_rate": 0.4}}
    mpc, low = robot(latency)
    states = measured(mpc, 80)
    expected = by_hand(mpc, low, states, commands)
    mpc, low = robot(latency)
    with mpc.running(low, thread=thread) as loop:
        u = run(loop, states[:30])
        mpc.command(speed=0.2, yaw_rate=0.4)
        u = np.concatenate([u, run(loop, states, 30)])
        assert (loop.asked, loop.missed) == (7, 0)
        assert loop.acting.measured_at == pytest.approx(0.12 if latency else 0.14)
    np.testing.assert_array_equal(u, expected)


@pytest.mark.parametrize("make", [solvers.Vwbc, solvers.Riccati, solvers.FeedforwardPD])
def test_every_low_level_runs_in_a_loop_and_measured_contacts_go_through_it(make):
    mpc, low = robot(make=make, contacts="measured")
    states = measured(mpc, 40)
    flags = np.random.default_rng(2).integers(0, 2, (40, 4)).astype(float)
    expected = by_hand(mpc, low, states, {}, flags)
    mpc, low = robot(make=make, contacts="measured")
    with mpc.running(low) as loop:
        np.testing.assert_array_equal(run(loop, states, flags=flags), expected)
        np.testing.assert_array_equal(loop.scheduled, loop.plan.phases[0].p[0, -4:] * 0 + low.contacts(TICK * 39))
        with pytest.raises(SolverError, match="contacts do not fit - got none, expected flags"):
            loop.control(states[0], 0.1)


def test_the_first_plan_is_made_by_begin_or_by_the_first_tick():
    found = []
    for begins in (True, False):
        mpc, low = robot()
        states = measured(mpc, 25)
        mpc.reset()
        with mpc.running(low) as loop:
            assert loop.plan is None
            assert loop.acting is None
            if begins:
                loop.begin(states[0], 0.0)
                assert loop.acting.iterations == 3
            found.append(run(loop, states))
            assert (loop.asked, loop.taken) == (2, 2)
    np.testing.assert_array_equal(*found)


def test_the_plan_of_a_loop_is_a_copy_that_stays():
    mpc, low = robot()
    states = measured(mpc, 100)
    with mpc.running(low) as loop:
        run(loop, states[:25])
        plan = loop.plan
        assert plan.measured_at == loop.acting.measured_at == pytest.approx(0.02)
        assert (plan.iterations, plan.status) == (loop.acting.iterations, loop.acting.status)
        kept = [part.states.copy() for part in plan.parts]
        run(loop, states, 25)
        assert loop.plan.start > plan.start
    assert all(np.array_equal(part.states, x) for part, x in zip(plan.parts, kept, strict=True))


# ---- stop and start


def test_after_a_stop_plans_go_on_by_hand_and_in_another_loop():
    mpc, low = robot()
    states = measured(mpc, 90)
    expected = by_hand(mpc, low, states, {})
    mpc, low = robot()
    loop = mpc.running(low)
    loop.start()
    u = run(loop, states[:32])
    loop.stop()
    loop.stop()  # does nothing
    assert not loop.is_running
    # what was asked for at 60 ms is ready and acts from 80 ms on; until then the low level follows the plan before
    assert low.plan.start == pytest.approx(0.06)
    assert mpc._native.plan.start == pytest.approx(0.08)
    np.testing.assert_array_equal(u, expected[:32])
    again = low.control(states[32], TICK * 32)
    np.testing.assert_array_equal(again, expected[32])
    with mpc.running(low) as another:
        np.testing.assert_array_equal(run(another, states, 33), expected[33:])
        assert another.asked == 5
    mpc.reset()
    plan = mpc.plan(mpc.initial, 0.0)
    np.testing.assert_array_equal(plan.parts[0].states, robot()[0]._native.plan.parts[0].states)


def test_a_loop_ends_with_its_block_also_after_an_error_and_when_nothing_refers_to_it():
    mpc, low = robot(declared=mass())
    with pytest.raises(ValueError, match="of the user"), mpc.running(low) as loop:
        raise ValueError("of the user")
    assert not loop.is_running
    assert loop._memory.c.thread is None
    loop = mpc.running(low)
    loop.start()
    memory = loop._memory
    assert memory.c.thread
    del loop
    gc.collect()
    assert memory.c.thread is None
    mpc.plan(mpc.initial, 0.02)


LEFT = """
import os, sys
from tests.solvers.receding.test_loop import mass, robot, run, measured
from piaffe.errors import SolverError

mpc, low = robot(declared=mass())
loop = mpc.running(low)
loop.start()
states = measured(mpc, 40)
run(loop, states[:25])
child = os.fork()
if child == 0:
    try:
        loop.control(states[25], 0.05)
    except SolverError as error:
        assert "its thread is in another process" in str(error), error
        loop.stop()
        loop.start()
        run(loop, states, 25)
        assert loop.taken > 0
        sys.exit(7)
    sys.exit(1)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
run(loop, states, 25)
print(loop.asked)
"""


def test_a_program_ends_while_a_loop_runs_and_a_forked_one_begins_anew():
    made = subprocess.run([sys.executable, "-c", LEFT], capture_output=True, text=True, timeout=120, check=False)
    assert (made.stdout, made.returncode) == ("3\n", 0), made.stderr


# ---- late plans, with a planner that waits until it may go on


class Gate:
    """Stands before the planner of a loop: a plan is made when it is opened."""

    def __init__(self, loop):
        own = loop._memory.c.make
        kind = ct.CFUNCTYPE(ct.c_int, ct.c_void_p, ct.c_void_p, ct.c_double, ct.c_void_p)
        make, self._open, self._reached = kind(own), threading.Semaphore(0), threading.Semaphore(0)
        self.code = 0

        def wait(*arguments):
            self._reached.release()
            assert self._open.acquire(timeout=LIMIT)
            return make(*arguments) or self.code

        self._kept = kind(wait)
        loop._memory.c.make = ct.cast(self._kept, ct.c_void_p)

    def open(self, reached=True):
        """Let the plan be made that waits, or is about to."""
        assert not reached or self._reached.acquire(timeout=LIMIT)
        self._open.release()


def test_a_late_plan_is_missed_and_acts_as_soon_as_it_is_complete():
    mpc, low = robot(declared=mass())
    x, loop = mpc.initial, mpc.running(low)
    gate = Gate(loop)
    with loop:
        for k in range(23):  # asked at 20 ms for 40 ms
            loop.control(x, TICK * k)
        assert (loop.asked, loop.missed, loop.taken) == (2, 2, 0)  # the one of 40 ms could not begin
        gate.open()
        settle(loop)
        loop.control(x, 0.046)
        assert loop.acting.measured_at == pytest.approx(0.02)
        assert loop.is_planning  # the next one began at the first tick that was possible
        gate.open()
        settle(loop)
        acting = []
        for k in range(24, 43):
            loop.control(x, TICK * k)
            acting.append(loop.acting.measured_at)
            if loop.is_planning:
                gate.open()
                settle(loop)
        # those of 46 ms and of 60 ms both begin at a time of the grid, 80 ms
        np.testing.assert_allclose(acting, 16 * [0.02] + 3 * [0.06])
        assert (loop.asked, loop.missed) == (4, 2)


def test_a_planner_that_is_stuck_for_many_periods_leaves_the_last_plan():
    mpc, low = robot(declared=mass())
    loop = mpc.running(low)
    gate = Gate(loop)
    with loop:
        for k in range(103):
            loop.control(mpc.initial, TICK * k)
        assert (loop.asked, loop.missed, loop.taken) == (10, 10, 0)
        gate.open()
    assert low.plan.measured_at == 0.0
    assert mpc._native.plan.measured_at == pytest.approx(0.02)


def test_a_plan_that_is_not_finite_does_not_act():
    mpc, low = robot(declared=mass())
    loop = mpc.running(low)
    gate = Gate(loop)
    gate.code = NOT_FINITE_PLAN
    with loop:
        for k in range(21):
            loop.control(mpc.initial, TICK * k)
            if loop.is_planning:
                gate.open()
                settle(loop)
        loop.control(mpc.initial, 0.042)
        assert (loop.asked, loop.missed, loop.taken) == (2, 2, 0)
        gate.open(reached=False)  # begin makes a plan in this thread
        with pytest.raises(
            SolverError, match="there is no plan from this state - got numbers that are not finite at 0.0"
        ):
            loop.begin(mpc.initial, 0.05)


# ---- errors


def test_no_plan_is_asked_for_from_a_state_that_is_not_finite():
    mpc, low = robot(declared=mass())
    with mpc.running(low) as loop:
        run(loop, [mpc.initial] * 10)
        u = loop.control(np.array([np.nan, 0.5]), 0.02)
        assert (u, low.damped) == (0.0, 1)
        assert (loop.asked, loop.missed, loop.is_planning) == (1, 1, False)
        loop.control(mpc.initial, 0.022)
        assert loop._memory.c.asked_at == 0.022
        settle(loop)
        with pytest.raises(ProblemError, match="state is not finite"):
            loop.begin(np.array([np.nan, 0.0]), 0.06)


@pytest.mark.parametrize("thread", [True, False])
def test_the_end_of_the_motion_is_an_error_of_the_tick_and_the_last_plan_goes_on(thread):
    mpc, low = robot(declared=mass(0.1))
    with mpc.running(low, thread=thread) as loop:
        run(loop, [mpc.initial] * 50)  # at 80 ms it asks for a plan from 100 ms on, which is the end
        with pytest.raises(ProblemError, match=r"time is outside the motion - got t = 0.1 s, expected 0 ≤ t ≤ 0.08 s"):
            run(loop, [mpc.initial] * 51, 50)
        settle(loop)
        assert np.isfinite(loop.control(mpc.initial, 0.102)).all()
        with pytest.raises(ProblemError, match=r"time is outside the motion - got t = 0.104 s"):
            loop.begin(mpc.initial, 0.104)


@pytest.mark.parametrize(("own", "given", "acts"), [(0.0, 0.006, 0.006), (0.02, 0.006, 0.02), (0.0, 0.02, 0.02)])
def test_a_longer_latency_than_that_of_the_plans_delays_them(own, given, acts):
    mpc, low = robot(own)
    states = measured(mpc, 40)
    with mpc.running(low, thread=False, latency=given) as loop:
        since = []
        for k, x in enumerate(states):
            loop.control(x, TICK * k)
            since.append(TICK * k if loop.acting is None else TICK * k - loop.acting.measured_at)
            assert (loop.planning_seconds > 0) == (k > 0 and k % 10 == 0)
    until = round(acts / TICK)  # from 20 and 40 ms on
    np.testing.assert_allclose(since[20:], TICK * np.where(np.arange(20) % 10 < until % 10, 10, 0)
                               + TICK * (np.arange(20) % 10) + (0.02 if until == 10 else 0.0), atol=1e-9)  # fmt: skip
    with pytest.raises(SolverError, match=r"latency is out of range - got 0.03 s, expected 0 to the period, 0.02 s"):
        mpc.running(low, latency=0.03)


def test_the_low_level_tells_the_flags_of_the_plan_that_acts():
    mpc, low = robot()
    first = low.plan
    with mpc.running(low) as loop:
        run(loop, measured(mpc, 65))
        times = np.arange(0.0, 0.4, 0.003)
        flags = np.array([low.contacts(t) for t in times])
        np.testing.assert_array_equal(flags, [contacts_at(loop.plan, t) for t in times])
        assert (flags != [contacts_at(first, t) for t in times]).any()
        np.testing.assert_array_equal(loop.scheduled, low.contacts(TICK * 64))


def test_time_does_not_go_back():
    mpc, low = robot(declared=mass())
    with mpc.running(low) as loop:
        loop.control(mpc.initial, 0.01)
        loop.control(mpc.initial, 0.01)
        with pytest.raises(ProblemError, match="time goes back - got 0.002 s after 0.01 s"):
            loop.control(mpc.initial, 0.002)


def test_while_a_loop_runs_it_owns_the_receding_horizon():
    mpc, low = robot(declared=mass())
    loop = mpc.running(low)
    with pytest.raises(SolverError, match=r"it does not run - got a call before start\(\) or after stop\(\)"):
        loop.control(mpc.initial, 0.0)
    with loop:
        for call in (lambda: mpc.plan(mpc.initial, 0.5), mpc.reset, loop.start, mpc.running(low).start):
            with pytest.raises(SolverError, match="a loop makes its plans - got"):
                call()
        with pytest.raises(ShapeError, match="state has the wrong size"):
            loop.control(np.zeros(3), 0.0)
        with pytest.raises(ShapeError, match="state"):
            loop.begin(np.zeros(3), 0.0)


def test_what_cannot_run_in_a_loop_is_refused():
    mpc, low = robot(declared=mass())
    plan = low.plan
    for other in (solvers.Riccati(plan, backend="numpy"), solvers.Vwbc(plan, qp="numpy")):
        with pytest.raises(SolverError, match="the low level is not compiled - got"):
            mpc.running(other)
    readable = solvers.RecedingHorizon(mass(), latency=PERIOD, backend="numpy")
    with pytest.raises(SolverError, match="the receding horizon is not compiled - got numpy"):
        readable.running(low)
    with pytest.raises(SolverError, match="the low level is for other plans"):
        robot(declared=mass())[0].running(robot()[1])
    mpc, low = robot(0.0, declared=mass())
    with pytest.raises(SolverError, match="a plan in a thread needs time - got a latency of 0 s, expected up to the p"):
        mpc.running(low)


def test_without_threads_plans_are_made_within_the_tick(monkeypatch):
    library = loop_memory.loop_library(threads=False)
    monkeypatch.setattr(loop_memory, "loop_library", lambda: library)
    mpc, low = robot(declared=mass())
    with pytest.raises(SolverError, match="no thread for plans - got this platform has no POSIX threads, expected a"):
        mpc.running(low).start()
    with mpc.running(low, thread=False) as loop:
        run(loop, [mpc.initial] * 31)
        assert loop.taken == 2
