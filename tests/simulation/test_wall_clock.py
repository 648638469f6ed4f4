"""The real clock, replaced by one that is written here: what is waited for, and what is missed."""

import sys
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

import numpy as np
import pytest

from piaffe.errors import ModelError
from piaffe.simulation import Command, Deadlines, Plant, WallClock, run_online
from tests.simulation.online import Angles, Springs, Sway
from tests.simulation.plans import BODY, ROBOT

START = BODY.state(joints="stand")


class Bench(Executor):
    """A clock that goes on only when it is waited for or when work is done, and a thread that takes known times.

    Args:
        plan_s: time of each plan after the first [s].
    """

    def __init__(self, *plan_s: float) -> None:
        self.time, self.waits = 100.0, []  # type: float, list[float]
        self._plan_s, self._jobs = list(plan_s), []  # type: list[float], list[tuple[float, Future[Any], Any]]

    def now(self) -> float:
        return self.time

    def wait(self, seconds: float) -> None:
        assert seconds > 0
        self.waits.append(seconds)
        self.spend(seconds)

    def spend(self, seconds: float) -> None:
        self.time += seconds
        for job in [each for each in self._jobs if each[0] <= self.time + 1e-9]:
            self._jobs.remove(job)
            try:
                job[1].set_result(job[2]())
            except ValueError as error:
                job[1].set_exception(error)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **options: Any) -> Future[Any]:
        assert not self._jobs  # one plan at a time
        future: Future[Any] = Future()
        self._jobs.append((self.time + self._plan_s.pop(0), future, lambda: fn(*args, **options)))
        return future

    def clock(self) -> WallClock:
        return WallClock(self.now, self.wait, self)


def run(bench: Bench, planner: Any, low: Any, **changes: Any) -> Any:
    options: dict[str, Any] = {"seconds": 0.1, "latency": 0.012, "initial": START, **changes}
    return run_online(planner, low, Plant(ROBOT), wall_clock=bench.clock(), **options)


def test_with_time_enough_the_robot_moves_as_without_the_clock() -> None:
    bench = Bench(*5 * [0.011])
    commands = (Command(0.02, {"speed": 0.3}),)
    made = run(bench, Sway(), Springs(), commands=commands)
    plain = run_online(Sway(), Springs(), Plant(ROBOT), seconds=0.1, latency=0.012, initial=START, commands=commands)
    np.testing.assert_array_equal(made.states, plain.states)
    np.testing.assert_array_equal(made.commands, plain.commands)
    np.testing.assert_array_equal(made.plans.times, plain.plans.times)
    assert made.deadlines == Deadlines(4, 0, len(made.times), 0, pytest.approx(0.0, abs=1e-9))
    assert plain.deadlines is None
    assert bench.time == pytest.approx(100.099)  # the last step begins a step before the end
    assert made.summary()["deadlines"]["plans"] == 4


def test_an_episode_that_starts_later_in_the_motion_begins_at_once() -> None:
    bench = Bench(*5 * [0.011])
    made = run(bench, Sway(), Springs(), start=3.0)
    assert made.end == pytest.approx(3.1)
    assert bench.time == pytest.approx(100.099)
    assert made.deadlines.latest == pytest.approx(0.0, abs=1e-9)


def test_a_plan_that_is_late_is_missed_and_the_one_before_goes_on() -> None:
    # due 12 ms after 20, 40, 60 and 80 ms; that of 40 ms is ready at 55 ms, and at 60 ms the next begins
    planner, low = Sway(), Springs()
    made = run(Bench(0.010, 0.015, 0.010, 0.010), planner, low)
    assert (made.deadlines.plans, made.deadlines.missed_plans) == (4, 1)
    np.testing.assert_allclose(made.plans.times, [0.0, 0.02, 0.06, 0.08], atol=1e-9)
    ages = made.ages[np.abs(made.times - 0.070) < 1e-9]
    np.testing.assert_allclose(ages, 0.05)  # still the plan of 20 ms


def test_a_plan_that_blocks_the_next_is_taken_when_it_is_ready_and_both_are_missed() -> None:
    planner = Sway()
    commands = (Command(0.04, {"speed": 0.3}),)
    made = run(Bench(0.025, 0.010, 0.010), planner, Springs(), commands=commands)
    # that of 20 ms is ready at 45 ms; at 40 ms none begins, at 52 ms it is taken; then 60 and 80 ms
    np.testing.assert_allclose(made.plans.times, [0.0, 0.02, 0.06, 0.08], atol=1e-9)
    assert (made.deadlines.plans, made.deadlines.missed_plans) == (4, 2)
    assert planner.told == [(2, {"speed": 0.3})]  # with the next plan that began
    assert made.commands[made.times < 0.0599].max() == 0.0
    assert made.commands[made.times > 0.0599, 0].min() == 0.3


def test_ticks_that_take_too_long_are_missed_and_made_up_for() -> None:
    bench, low = Bench(*5 * [0.001]), Springs()
    own = low.control

    def slow(x: np.ndarray, t: float) -> np.ndarray:
        bench.spend(0.0045 if len(low.ticks) == 10 else 0.0001)
        return own(x, t)

    low.control = slow  # type: ignore[method-assign]
    made = run(bench, Sway(), low, tick=0.002)
    # 4.5 ms late, then the next ones begin late by 2.5 and 0.6 ms and take 0.1 ms
    assert made.deadlines.missed_ticks == 2
    assert made.deadlines.latest == pytest.approx(0.0045)
    assert made.deadlines.missed_plans == 0
    assert bench.time == pytest.approx(100.099)
    assert made.success


def test_without_a_planner_ticks_are_paced() -> None:
    bench = Bench()
    made = run(bench, None, Springs(Angles(ROBOT.pose("stand"))), seconds=0.02)
    assert (made.deadlines.plans, made.deadlines.missed_plans, made.deadlines.ticks) == (0, 0, 10)
    assert bench.waits == pytest.approx([0.001] * 19)


def test_errors_of_the_planner_reach_the_caller_and_the_interpreter_is_as_before() -> None:
    class Broken(Sway):
        def plan(self, x: np.ndarray, t: float) -> Angles:
            if t > 0.03:
                raise ValueError("broken")
            return super().plan(x, t)

    sys.setswitchinterval(0.007)
    with pytest.raises(ValueError, match="broken"):
        run(Bench(0.001, 0.001), Broken(), Springs())
    assert sys.getswitchinterval() == pytest.approx(0.007, abs=2e-6)  # whole microseconds
    sys.setswitchinterval(0.005)  # Python's default


def test_a_thread_and_the_real_clock_run_an_episode() -> None:
    made = run_online(Sway(), Springs(), Plant(ROBOT), seconds=0.06, latency=0.02, initial=START, wall_clock=True)
    assert made.success
    assert made.deadlines is not None
    assert (made.deadlines.plans, made.deadlines.ticks) == (2, 30)
    assert made.deadlines.latest > 0


def test_a_plan_without_time_is_refused() -> None:
    with pytest.raises(ModelError, match="a plan needs time against the real clock - got latency=0, expected at least"):
        run(Bench(), Sway(), Springs(), latency=0.0)
