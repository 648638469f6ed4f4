"""Deterministic episodes of a compiled planner and low level: the loop in C does what calls from Python do."""

from typing import Any

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ProblemError
from piaffe.simulation import Command, KalmanEstimator, OnlineEpisode, Plant, Push, SensorNoise, online_run, run_online
from tests.simulation.test_loop import ROBOT, trot

RECORD = (
    "times", "states", "estimates", "controls", "torques", "limited", "forces", "slips", "planned", "ages",
    "qp_iterations", "last",
)  # fmt: skip


class ByHand:
    """A receding horizon that has no loops, so that Python decides when it plans."""

    def __init__(self, mpc: solvers.RecedingHorizon) -> None:
        self.period, self.initial, self.velocity = mpc.period, mpc.initial, mpc.velocity
        self.reset, self.plan, self.command = mpc.reset, mpc.plan, mpc.command


def assert_same(got: OnlineEpisode, expected: OnlineEpisode) -> None:
    for name in RECORD:
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name), err_msg=name)
    for name in ("times", "iterations"):
        np.testing.assert_array_equal(getattr(got.plans, name), getattr(expected.plans, name))
    for name in ("end", "fault", "fallbacks", "damped", "collisions"):
        assert getattr(got, name) == getattr(expected, name), name
    assert got.plans.statuses == expected.plans.statuses


@pytest.mark.parametrize(("make", "latency"), [(solvers.Vwbc, 0.0), (solvers.Vwbc, 0.02), (solvers.Riccati, 0.01)])
def test_a_loop_in_simulated_time_moves_the_robot_as_calls_from_python_do(make: Any, latency: float) -> None:
    made = []
    for wrap in (ByHand, lambda mpc: mpc):
        mpc, _ = trot(latency=latency)
        low = make(mpc.plan(mpc.initial, 0.0), contacts="measured")
        run = run_online(
            wrap(mpc), low, Plant(ROBOT, noise=SensorNoise(joints=0.002)), seconds=0.3, latency=latency, seed=3,
            start=0.5, commands=(Command(0.57, {"speed": 0.5}),), pushes=(Push(time=0.6, velocity=(0.0, 0.3, 0.0)),),
        )  # fmt: skip
        made.append((run, low.plan.measured_at))
    assert_same(made[1][0], made[0][0])
    assert made[1][1] == made[0][1]
    assert len(made[0][0].plans.times) == (15 if latency < 0.02 else 14)
    np.testing.assert_array_equal(made[1][0].commands[-1], made[0][0].commands[-1])


def test_an_estimator_gets_the_flags_of_the_plan_that_acts() -> None:
    made = []
    for wrap in (ByHand, lambda mpc: mpc):
        mpc, low = trot(latency=0.02)
        plant = Plant(ROBOT, noise=SensorNoise(joints=0.001))
        made.append(run_online(wrap(mpc), low, plant, seconds=0.2, latency=0.02, estimator=KalmanEstimator(ROBOT)))
    assert_same(made[1], made[0])


def test_a_latency_that_the_planner_does_not_know_delays_its_plans() -> None:
    made = []
    for wrap in (ByHand, lambda mpc: mpc):
        mpc, low = trot(latency=0.0)
        made.append(run_online(wrap(mpc), low, Plant(ROBOT), seconds=0.1, latency=0.012))
    assert_same(made[1], made[0])
    assert np.nanmin(made[1].ages) == pytest.approx(0.012)


def test_a_plan_does_not_act_before_its_start() -> None:
    mpc, low = trot(latency=0.006)  # plans begin at multiples of 10 ms
    made = run_online(mpc, low, Plant(ROBOT), seconds=0.1, latency=0.006)
    ages = made.ages[made.times > 0.02 - 1e-9]
    assert np.nanmin(ages) == pytest.approx(0.01)
    assert np.nanmax(ages) == pytest.approx(0.028)


def test_the_time_of_plans_is_taken_off_the_time_of_ticks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(online_run, "thread_time", lambda: 0.0)
    mpc, low = trot(latency=0.0)
    made = run_online(mpc, low, Plant(ROBOT), seconds=0.1)
    plans = np.isin(np.round(1e3 * made.times), np.round(1e3 * made.plans.times[1:]))
    assert plans.sum() == 4
    assert np.all(made.tick_seconds[plans] < 0)
    assert np.all(made.tick_seconds[~plans] == 0)
    assert np.all(made.plans.seconds > 0)


@pytest.mark.parametrize("latency", [0.0, 0.02])
def test_the_end_of_a_motion_is_reached_and_not_passed(latency: float) -> None:
    body = models.WholeBody(ROBOT)
    motion = ocp.Motion(ocp.Phase("stand", models.stance("FL FR HL HR"), 0.2, ocp.Keyframe(position=(0, 0, 0.25))))
    objective = ocp.Objective(
        ocp.track(models.base.position, 50.0), ocp.track(models.base.orientation, 2.0),
        ocp.track(models.joints.position, 1.0), ocp.regularize(models.joints.torque, 0.01),
    )  # fmt: skip
    problem = ocp.Problem(motion, body.over(0.1, dt=0.01), objective, initial=body.state(joints="stand"))
    mpc = solvers.RecedingHorizon(problem, latency=latency, iterations=1, first_iterations=5)
    low = solvers.Riccati(mpc.plan(mpc.initial, 0.0), gains=solvers.JointPD(20.0, 0.5))
    made = run_online(mpc, low, Plant(ROBOT), seconds=0.2, latency=latency)
    assert (made.success, made.end) == (True, pytest.approx(0.2))
    with pytest.raises(ProblemError, match="time is outside the motion"):
        run_online(mpc, low, Plant(ROBOT), seconds=0.202, latency=latency)
    mpc.reset()  # refused if the loop were running
