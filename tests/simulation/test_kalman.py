"""The Kalman filter: exact on exact readings, close to the truth on a plant with noise."""

from functools import cache
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ModelError
from piaffe.simulation import KalmanEstimator, KalmanNoise, OnlineEpisode, Plant, Reading, SensorNoise, run_online
from tests.simulation.online import STAND, Angles, Springs
from tests.simulation.plans import BODY, ROBOT

START = BODY.state(joints="stand")
NOISE = SensorNoise(
    orientation=0.003, angular_velocity=0.005, acceleration=0.005, joints=0.001, joint_velocity=0.05, position=1.0,
    linear_velocity=1.0,
)  # fmt: skip
GAITS = str(Path(__file__).parents[2] / "examples" / "gaits.py")


def rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@cache
def pace() -> tuple[solvers.SolvedPlan, models.Robot]:
    compiled = ocp.compile_problem(ocp.load_problem(f"{GAITS}:pace"))
    solution = solvers.MSiLQR(compiled).solve().raise_if_failed()
    return solvers.SolvedPlan(solution, compiled), compiled.phases[0].mode.model.robot


def paced(noise: SensorNoise, **options: Any) -> tuple[OnlineEpisode, np.ndarray]:
    """Return an episode of a pace whose low level is given estimates, and their errors."""
    plan, robot = pace()
    seconds, estimator = round(float(plan.phases[-1].times[-1]), 6), KalmanEstimator(robot, **options)
    low = solvers.Vwbc(plan)
    made = run_online(None, low, Plant(robot, noise=noise), seconds=seconds, estimator=estimator)
    return made, made.estimates - made.states


@pytest.mark.parametrize(("contacts", "position", "velocity"), [("schedule", 8e-3, 0.02), ("measured", 4e-3, 0.01)])
@pytest.mark.parametrize("noise", [SensorNoise(), NOISE])
def test_a_pace_is_estimated_and_controlled_from_the_estimate(
    contacts: str, position: float, velocity: float, noise: SensorNoise
) -> None:
    made, off = paced(noise, contacts=contacts)
    assert made.success
    assert rms(off[:, :3]) < position
    assert rms(off[:, 19:22]) < velocity
    if noise is NOISE:  # orientation and joints are as they are measured; place and velocity of the base are not used
        assert np.std(off[:, 7:19]) == pytest.approx(0.001, rel=0.1)
        assert np.std(off[:, 25:]) == pytest.approx(0.05, rel=0.1)


def test_feet_that_have_just_landed_do_not_count() -> None:
    at_once = rms(paced(NOISE, settle=0.0)[1][:, 19:22])
    assert rms(paced(NOISE)[1][:, 19:22]) < 0.5 * at_once


def test_balls_that_roll_are_no_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    rolling = abs(paced(SensorNoise(), contacts="measured")[1][-1, 0])
    zero = pin.Motion.Zero()
    own = pin.getFrameVelocity

    def without_spin(*args: Any) -> Any:
        motion = own(*args)
        return pin.Motion(motion.linear, zero.angular)

    monkeypatch.setattr(pin, "getFrameVelocity", without_spin)
    assert abs(paced(SensorNoise(), contacts="measured")[1][-1, 0]) > 4 * rolling


def standing(estimator: KalmanEstimator, seconds: float = 1.5) -> OnlineEpisode:
    low = Springs(Angles(STAND))
    low.control = lambda x, t: 30 * (STAND - x[7:19]) - 0.5 * x[25:37]  # type: ignore[method-assign]
    return run_online(None, low, Plant(ROBOT), seconds=seconds, initial=START, estimator=estimator)


def test_a_wrong_start_converges_to_the_truth_in_height_and_velocity(monkeypatch: pytest.MonkeyPatch) -> None:
    estimator = KalmanEstimator(ROBOT, contacts="measured")
    own = KalmanEstimator.reset

    def astray(self: KalmanEstimator, x: np.ndarray) -> None:
        own(self, x)
        self.mean[:3] += (0.1, -0.2, 0.15)
        self.mean[6:] += np.tile((0.1, -0.2, 0.15), 4)
        self.mean[3:6] += (0.5, 0.4, -0.3)
        self.covariance = np.eye(18)

    monkeypatch.setattr(KalmanEstimator, "reset", astray)
    made = standing(estimator)
    off = made.estimates[-1] - made.states[-1]
    assert np.abs(off[2]) < 2e-3  # feet sink into the ground by so much
    assert np.abs(off[19:22]).max() < 2e-3
    assert np.abs(off[:2]).max() > 0.05  # nothing tells where in the plane the robot is
    monkeypatch.undo()
    right = standing(KalmanEstimator(ROBOT, contacts="measured"))
    assert np.abs(right.estimates[-1] - right.states[-1])[:3].max() < 3e-3
    variance = estimator.covariance.diagonal()
    assert variance[2] < 1e-4 < variance[0]  # the filter knows what it does not know
    np.testing.assert_allclose(estimator.covariance, estimator.covariance.T, atol=1e-12)
    assert np.linalg.eigvalsh(estimator.covariance).min() > 0


def test_in_flight_the_base_is_integrated_and_feet_go_along() -> None:
    estimator = KalmanEstimator(ROBOT)
    x = BODY.state(joints="stand", position=(0, 0, 1.0), linear_velocity=(1.0, 0.5, 2.0), rpy=(0.3, -0.2, 1.0))
    estimator.reset(x)
    air, h = np.zeros(4), 0.002
    for k in range(100):
        reading = Reading(np.zeros(3), np.zeros(3), x[3:7], x[7:19], np.zeros(12), np.ones(4), air)
        got = estimator.estimate(reading, 0.0 if k == 0 else h)
    t = 99 * h
    np.testing.assert_allclose(got[19:22], (1.0, 0.5, 2.0 - 9.81 * t), atol=1e-7)
    np.testing.assert_allclose(got[:3], (t, 0.5 * t, 1.0 + 2.0 * t - 9.81 / 2 * t**2), atol=1e-7)
    legs = models.Kinematics(ROBOT).world_feet(got[None, :3], got[None, 3:7], got[None, 7:19])[0]
    np.testing.assert_allclose(estimator.mean[6:].reshape(4, 3), legs, atol=1e-6)


def test_an_accelerometer_feels_gravity_pushes_and_the_turn_of_the_base() -> None:
    plant = Plant(ROBOT)
    x = BODY.state(joints="stand", rpy=(0, pi / 2, 0))
    before = x.copy()
    x[19:22] = (0.5, 0.0, 0.2)
    reading = plant.sensors(0).reading(x, before, 0.1, np.zeros(4), np.ones(4))
    # the base's x axis points down: its specific force along x is −(0.2 / 0.1 + 9.81), along z it is that of world x
    np.testing.assert_allclose(reading.acceleration, (-(2.0 + 9.81), 0.0, 5.0), atol=1e-9)
    noisy = Plant(ROBOT, noise=SensorNoise(acceleration=0.3)).sensors(1)
    many = np.array([noisy.reading(x, x, 0.1, np.zeros(4), np.ones(4)).acceleration for _ in range(400)])
    assert many.std(axis=0) == pytest.approx([0.3] * 3, rel=0.15)


def test_what_is_unknown_or_out_of_range_is_refused() -> None:
    with pytest.raises(ModelError, match="estimator: contacts is unknown - got 'guess', expected 'schedule' or"):
        KalmanEstimator(ROBOT, contacts="guess")  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="estimator: settle is out of range - got -0.1"):
        KalmanEstimator(ROBOT, settle=-0.1)
    with pytest.raises(ModelError, match="kalman noise: slip is out of range - got -1"):
        KalmanNoise(slip=-1)
