"""Natural sizes: 1 for robots of the size of Mini Cheetah, proportional to the robot if it is smaller or larger."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from piaffe import models
from piaffe.models import natural
from piaffe.ocp import Sizes

from ..robots import ROBOTS, scaled

OF_MODEL = (natural.force, natural.torque, natural.speed, natural.length)


def numbers(robot: models.Robot) -> list[float]:
    """Return the units of force, torque, speed and length of a model of a robot."""
    model = SimpleNamespace(robot=robot, sizes=natural.sizes(robot))
    return [unit(model) for unit in OF_MODEL]


def test_anymal_is_larger_than_robots_that_count_in_si_units() -> None:
    robot = models.load("anymal_c")
    sizes = natural.sizes(robot)
    assert sizes.mass == pytest.approx(52.13485 / 8.252)
    assert 1 < sizes.length < 6
    assert numbers(robot)[0] == pytest.approx(sizes.mass * sizes.length / sizes.time**2)


@pytest.mark.parametrize("name", [name for name in ROBOTS if name != "anymal_c"])
def test_other_known_robots_count_in_si_units(name: str) -> None:
    robot = models.load(name)
    assert natural.sizes(robot) == Sizes()
    assert numbers(robot) == [1.0] * 4


@pytest.mark.parametrize("size", [0.01, 0.1, 10.0])
def test_sizes_of_a_scaled_robot_are_proportional(size: float) -> None:
    """Forces and torques of a robot that is scaled in length go with its cube and its fourth power, its speeds with its
    root."""
    robot = scaled(models.load("mini_cheetah"), size)
    sizes = natural.sizes(robot)
    assert (sizes.length, sizes.time, sizes.mass) == pytest.approx((size, size**0.5, size**3))
    assert numbers(robot) == pytest.approx([size**3, size**4, size**-0.5, size])
    model = SimpleNamespace(robot=robot, sizes=sizes)
    assert natural.impulse(model) == pytest.approx(0.1 * 8.252 * size**3.5)


@pytest.mark.parametrize("name", ["go2", "anymal_c"])
def test_sizes_of_scaled_robots_have_one_ratio(name: str) -> None:
    small, large = (np.array(numbers(scaled(models.load(name), size))) for size in (0.01, 10.0))
    np.testing.assert_allclose(large / small, [1e9, 1e12, 1000**-0.5, 1e3])


def test_the_time_is_longer_where_gravity_is_small() -> None:
    robot = scaled(models.load("mini_cheetah"), 0.1)
    robot.model.gravity.linear = np.array([0.0, 0.0, -9.81 / 4])
    assert natural.sizes(robot).time == pytest.approx(2 * 0.1**0.5)
    robot.model.gravity.linear = np.zeros(3)  # it floats: there is no time of a fall
    assert natural.sizes(robot).time == pytest.approx(0.1**0.5)


def test_strong_motors_count_in_their_own_torques() -> None:
    robot = models.load("mini_cheetah")
    strong = replace(robot, torque_limit=100 * robot.torque_limit, joint_speed_limit=robot.joint_speed_limit / 100)
    assert numbers(strong) == pytest.approx([1.0, 100.0, 0.01, 1.0])


def test_a_robot_without_limits_has_the_sizes_of_its_length_and_mass() -> None:
    robot, infinite = models.load("mini_cheetah"), np.full(12, np.inf)
    free = replace(robot, torque_limit=infinite, joint_speed_limit=infinite)
    assert numbers(free) == [1.0] * 4
    assert numbers(scaled(free, 0.1)) == pytest.approx([1e-3, 1e-4, 0.1**-0.5, 0.1])


def test_baumgarte_and_friction_speed_have_natural_times() -> None:
    robot = models.load("mini_cheetah")
    small, other = models.WholeBody(scaled(robot, 0.01)), models.WholeBody(robot)
    assert small.gamma(1e-6) == pytest.approx(10 * other.gamma(1e-6))
    assert small.gamma(0.01) == other.gamma(0.01) == 200.0
    assert small.numbers()["friction_speed"] == pytest.approx(10 * other.numbers()["friction_speed"])
    euler, usual = (models.WholeBody(each, integrator="euler") for each in (scaled(robot, 0.01), robot))
    assert euler.gamma(0.01) == pytest.approx(10 * usual.gamma(0.01))


def test_the_guess_of_torques_is_similar() -> None:
    """On two feet no forces give the wrench: the nearest ones do not depend on the unit of length."""
    guesses = []
    for size in (0.01, 1.0):
        body = models.WholeBody(scaled(models.load("mini_cheetah"), size))
        x = body.state(position=(0, 0, 0.2 * size), rpy=(0.5, 0.1, 0.0), joints="stand")
        p = {name: value[None] for name, value in body.numbers().items()}
        p["contact"] = np.array([[0.0, 1.0, 0.0, 1.0]])
        (torques,) = body.control_guess([SimpleNamespace(sample={})], np.vstack([x, x]), p).values()  # type: ignore[list-item]
        guesses.append(torques / size**4)
    assert np.abs(guesses[1]).max() > 1.0
    np.testing.assert_allclose(*guesses, atol=1e-6)
