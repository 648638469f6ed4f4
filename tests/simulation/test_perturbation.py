"""Perturbed starts: their spread, on the manifold."""

import numpy as np
import pinocchio as pin
import pytest

from piaffe.errors import ModelError
from piaffe.simulation import Perturbation, torque_plant
from tests.simulation.plans import BODY, ROBOT

PLANT = torque_plant(ROBOT)
START = BODY.state(position=(0.3, -0.2, 0.25), rpy=(0.4, -0.7, 2.0), joints="stand", linear_velocity=(0.1, 0, 0))


def rotation(x: np.ndarray) -> np.ndarray:
    return pin.Quaternion(x[[4, 5, 6, 3]]).matrix()


def test_standard_deviations_are_those_declared_and_the_attitude_turns_about_body_axes() -> None:
    made = Perturbation(joints=0.02, orientation=0.03, linear_velocity=0.04, angular_velocity=0.05)
    near = np.array([made.around(PLANT, START, seed) for seed in range(600)])
    turns = np.array([pin.log3(rotation(START).T @ rotation(x)) for x in near])
    for values, declared in (
        (near[:, 7:19] - START[7:19], 0.02), (turns, 0.03), (near[:, 19:22] - START[19:22], 0.04),
        (near[:, 22:25], 0.05),
    ):  # fmt: skip
        assert values.std() == pytest.approx(declared, rel=0.05)
        assert np.abs(values.mean(axis=0)).max() < 5 * declared / np.sqrt(600)
    assert np.linalg.norm(near[:, 3:7], axis=1) == pytest.approx(1.0)
    np.testing.assert_array_equal(near[:, [0, 1]], np.tile(START[:2], (600, 1)))
    np.testing.assert_array_equal(near[:, 25:], np.tile(START[25:], (600, 1)))


def test_the_axes_of_the_attitude_are_independent_of_the_base() -> None:
    made = Perturbation(joints=0, orientation=0.03, linear_velocity=0, angular_velocity=0)
    tilted = made.around(PLANT, START, 5)
    level = made.around(PLANT, BODY.state(joints="stand"), 5)
    turned = pin.log3(rotation(START).T @ rotation(tilted))
    np.testing.assert_allclose(turned, pin.log3(rotation(level)), atol=1e-9)


def test_the_lowest_foot_stays_where_it_was() -> None:
    lowest = BODY.foot_positions(START)[:, 2].min()
    for seed in range(20):
        near = Perturbation().scaled(3).around(PLANT, START, seed)
        assert BODY.foot_positions(near)[:, 2].min() == pytest.approx(lowest, abs=1e-9)


def test_seeds_repeat_and_differ_and_factors_scale() -> None:
    one, again, other = (Perturbation().around(PLANT, START, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 1e-3
    twice = Perturbation().scaled(2).around(PLANT, START, 1)
    np.testing.assert_allclose(twice[7:19] - START[7:19], 2 * (one[7:19] - START[7:19]), atol=1e-12)
    still = Perturbation().scaled(0).around(PLANT, START, 1)
    np.testing.assert_allclose(still, START, atol=1e-12)


@pytest.mark.parametrize("bad", [-0.1, float("nan"), "some", True])
def test_a_standard_deviation_is_a_number_from_zero_on(bad: object) -> None:
    with pytest.raises(
        ModelError, match=r"perturbation: joints is out of range - got .*, expected a standard deviation"
    ):
        Perturbation(joints=bad)  # type: ignore[arg-type]
