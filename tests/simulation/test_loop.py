"""Loops of planner and low level against the real clock: what an episode knows of them."""

import gc
import os
from typing import Any

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.models import base, feet, joints
from piaffe.simulation import Command, Plant, WallClock, run_online
from piaffe.simulation.real_time import garbage_kept, real_time

ROBOT = models.load("mini_cheetah")
LINUX = pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="priorities are those of Linux")


def trot(**options: Any) -> tuple[solvers.RecedingHorizon, solvers.Vwbc]:
    body = models.WholeBody(ROBOT)
    objective = ocp.Objective(
        ocp.track(base.position, weight=(0, 0, 50)), ocp.track(base.orientation, weight=2.0),
        ocp.track(base.linear_velocity, weight=10.0), ocp.track(base.angular_velocity, weight=1.0),
        ocp.track(joints.position, weight=1.0), ocp.track(joints.velocity, weight=0.01),
        ocp.track(feet.position, weight=10.0, mask=lambda s: 1 - s.feet.contact),
        ocp.regularize(joints.torque, weight=0.02),
    )  # fmt: skip
    limits = ocp.Constraints(models.friction_cone(mu=0.6), models.torque_limits())
    gait = models.gaits.trot(speed=0.3)
    problem = ocp.Problem(gait, body.over(0.2, dt=0.01), objective, limits, initial=body.state(joints="stand"))
    mpc = solvers.RecedingHorizon(problem, iterations=1, first_iterations=10, **options)
    return mpc, solvers.Vwbc(mpc.plan(mpc.initial, 0.0))


def test_an_episode_against_the_real_clock_runs_a_loop_and_gives_all_back() -> None:
    mpc, low = trot(latency=0.02)
    commands = (Command(0.05, {"speed": 0.1}),)
    made = run_online(mpc, low, Plant(ROBOT), seconds=0.2, latency=0.02, commands=commands, wall_clock=True)
    assert made.success, made.fault
    assert made.deadlines is not None
    assert (made.deadlines.plans, made.deadlines.ticks, len(made.times)) == (9, 100, 100)
    assert 0 < low.ticks == 100
    # the first plan acts from the start; others from a latency after their states, or later if they were missed
    assert made.plans.times[0] == 0.0
    assert made.plans.iterations[0] > 1
    assert set(made.plans.iterations[1:]) <= {1.0}
    assert set(made.plans.statuses) <= {each.name for each in solvers.Status}
    assert made.ages[:10] == pytest.approx(made.times[:10])
    late = made.deadlines.missed_plans
    assert len(made.plans.times) >= 9 - late
    assert set(np.unique(made.planned)) <= {0.0, 1.0}
    assert made.commands[0, 0] == pytest.approx(0.3)
    assert made.commands[-1, 0] == pytest.approx(0.1)
    plan = mpc.plan(made.last, 0.2)  # the loop has given the planner back
    assert low.plan.measured_at == pytest.approx(made.plans.times[-1])
    low.follow(plan)


def test_low_levels_that_are_not_compiled_run_with_a_thread_of_python() -> None:
    mpc, low = trot(latency=0.02)
    other = solvers.Riccati(low.plan, backend="numpy")
    made = run_online(mpc, other, Plant(ROBOT), seconds=0.06, latency=0.02, wall_clock=True)
    assert made.deadlines is not None
    assert made.deadlines.plans == 2
    assert made.success, made.fault


def test_errors_within_the_episode_stop_the_loop() -> None:
    mpc, low = trot(latency=0.02)

    def broken(done: float, seconds: float) -> None:
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        run_online(mpc, low, Plant(ROBOT), seconds=0.1, latency=0.02, wall_clock=True, progress=broken)
    mpc.reset()  # refused if the loop were running
    assert gc.get_freeze_count() == 0


@LINUX
def test_a_priority_that_the_system_refuses_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: Any) -> None:
        raise PermissionError

    with monkeypatch.context() as patched:
        patched.setattr(os, "sched_setscheduler", refuse)
        with WallClock() as clock:
            assert not clock.real_time
    with real_time(0) as given:
        assert not given


@LINUX
def test_a_priority_is_that_of_the_thread_only_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    set_to: list[tuple[int, int]] = []

    def note(pid: int, policy: int, parameters: Any) -> None:
        set_to.append((policy, parameters.sched_priority))

    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    monkeypatch.setattr(os, "sched_setscheduler", note)
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    with real_time(3) as given:
        assert given
    assert set_to == [(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 3), before]
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    with real_time(3) as given:
        assert not given
    assert len(set_to) == 2


def test_collections_leave_out_what_exists_and_frozen_objects_of_the_caller_stay() -> None:
    with garbage_kept():
        assert gc.get_freeze_count() > 0
        with garbage_kept():
            pass
        assert gc.get_freeze_count() > 0
    assert gc.get_freeze_count() == 0
