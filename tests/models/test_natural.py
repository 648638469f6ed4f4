"""Natural sizes: 1 for every known robot, proportional to the robot if it is much smaller or larger."""

from types import SimpleNamespace

import numpy as np
import pytest

from piaffe import models
from piaffe.models import natural

from ..robots import ROBOTS

SIZES = (natural.force, natural.torque, natural.speed, natural.length)


@pytest.mark.parametrize("name", ROBOTS)
def test_known_robots_count_in_si_units(name: str) -> None:
    model = SimpleNamespace(robot=models.load(name))
    assert [size(model) for size in SIZES] == [1.0] * 4


@pytest.mark.parametrize("scale", [0.01, 10.0])
def test_sizes_of_a_scaled_robot_are_proportional(scale: float) -> None:
    """Mass, torques and speeds of a robot that is scaled in length go with its cube, its fourth power and its root."""

    def robot(by: float) -> SimpleNamespace:
        place = SimpleNamespace(translation=np.array([0.0, 0.0, 0.25 * by]))
        return SimpleNamespace(
            robot=SimpleNamespace(
                mass=100.0 / 9.81 * by**3,
                torque_limit=np.array([20.0 * by**4, 5.0 * by**4]),
                joint_speed_limit=np.array([20.0 / by**0.5, np.inf]),
                model=SimpleNamespace(jointPlacements=[place]),
            )
        )

    assert natural.force(robot(scale)) == pytest.approx(scale**3)
    assert natural.torque(robot(scale)) == pytest.approx(scale**4)
    assert natural.length(robot(scale)) == pytest.approx(scale)
    assert natural.speed(robot(scale)) == (pytest.approx(scale**-0.5) if scale**-0.5 >= 8 else 1.0)


def test_a_robot_without_limits_has_sizes() -> None:
    infinite = np.array([np.inf, np.inf])
    model = SimpleNamespace(robot=SimpleNamespace(torque_limit=infinite, joint_speed_limit=infinite))
    assert natural.torque(model) == natural.speed(model) == 1.0
