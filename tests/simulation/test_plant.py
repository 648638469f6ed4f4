"""Plants: masses, payloads, ground; what is not in range."""

from typing import Any

import mujoco
import numpy as np
import pytest

from piaffe import models
from piaffe.errors import ModelError, UnknownNameError
from piaffe.simulation import Plant, SensorNoise, run_online
from tests.simulation.online import STAND, Angles, Springs
from tests.simulation.plans import BODY, ROBOT

START = BODY.state(joints="stand")


def mass_matrix(model: Any, q: np.ndarray) -> np.ndarray:
    data, matrix = mujoco.MjData(model), np.zeros((18, 18))
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    for row, unit in zip(matrix, np.eye(18), strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    return matrix


def test_a_payload_is_the_one_that_models_put_on_a_robot() -> None:
    load = models.payload(0.8, (0.1, -0.03, 0.05))
    made = Plant(ROBOT, payload=load).scene.compiled
    expected = models.Mujoco(ROBOT, payload=load, action=models.torques()).compiled()
    q = START[:19] + 0.1 * np.random.default_rng(0).standard_normal(19)
    q[3:7] /= np.linalg.norm(q[3:7])
    matrix = mass_matrix(made, q)
    np.testing.assert_allclose(matrix, mass_matrix(expected, q), atol=1e-10)
    assert np.abs(matrix - mass_matrix(Plant(ROBOT).scene.compiled, q)).max() > 0.01
    assert made.body_subtreemass[1] == pytest.approx(ROBOT.mass + 0.8)


def test_masses_are_scaled_all_or_by_name() -> None:
    q = START[:19]
    plain = mass_matrix(Plant(ROBOT).scene.compiled, q)
    heavier = Plant(ROBOT, mass_scale=1.3)
    np.testing.assert_allclose(mass_matrix(heavier.scene.compiled, q), 1.3 * plain, atol=1e-12)
    assert heavier.simulate(START).weight == pytest.approx(1.3 * ROBOT.mass * 9.81)
    trunk = Plant(ROBOT, mass_scale={"base_link": 1.5}).scene.compiled
    ours = ROBOT.model.inertias[1].mass
    assert trunk.body_subtreemass[1] == pytest.approx(ROBOT.mass + 0.5 * ours)
    np.testing.assert_allclose(mass_matrix(trunk, q)[6:, 6:], plain[6:, 6:], atol=1e-12)


def test_feet_carry_the_weight_that_a_plant_has() -> None:
    for changes in ({"mass_scale": 1.2}, {"payload": models.payload(0.5)}):
        plant = Plant(ROBOT, **changes)  # type: ignore[arg-type]
        low = Springs(Angles(STAND))
        low.control = lambda x, t: 30 * (STAND - x[7:19]) - 0.5 * x[25:37]  # type: ignore[method-assign]
        made = run_online(None, low, plant, seconds=1.0, tick=1e-3, initial=START)
        assert made.forces[-1, :, 2].sum() == pytest.approx(plant.simulate(START).weight, rel=0.01)


def test_two_simulations_of_a_plant_do_not_meet() -> None:
    plant = Plant(ROBOT)
    first, second = plant.simulate(START), plant.simulate(START)
    for _ in range(20):
        first.step(np.ones(12))
    np.testing.assert_array_equal(second.state, START)
    third = plant.simulate(START)
    for _ in range(20):
        third.step(np.ones(12))
    np.testing.assert_array_equal(first.state, third.state)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"timestep": 0.005}, "plant: timestep is out of range - got 0.005, expected 0 to 0.002 s"),
        ({"timestep": 0.0}, "plant: timestep is out of range - got 0.0"),
        ({"timestep": np.nan}, "plant: timestep is not a number - got nan"),
        ({"friction": -0.1}, "plant: friction is out of range - got -0.1"),
        ({"mass_scale": 0.0}, "mass_scale is out of range - got 0.0, expected a factor > 0"),
        ({"mass_scale": {"base_link": np.inf}}, "plant: mass_scale is not a number - got inf"),
    ],
)
def test_numbers_out_of_range_are_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ModelError, match=text):
        Plant(ROBOT, **changes)
    with pytest.raises(UnknownNameError, match="plant of 'solo12', mass_scale: no body 'truk'"):
        Plant(ROBOT, mass_scale={"truk": 1.0})
    with pytest.raises(ModelError, match="sensor noise: joints is out of range - got -1.0"):
        SensorNoise(joints=-1.0)
