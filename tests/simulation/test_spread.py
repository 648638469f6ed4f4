"""Initial states that differ from seed to seed."""

import numpy as np
import pytest

from piaffe import models
from piaffe.errors import SamplingError
from piaffe.models import base, joints
from piaffe.simulation.spread import STILL, Spread


@pytest.fixture(scope="module")
def body() -> models.WholeBody:
    return models.WholeBody(models.load("solo12"))


def test_seeds_give_states_of_their_own_and_always_the_same(body: models.WholeBody) -> None:
    x = body.state(joints="stand")
    first, again, other = (Spread().around(body, x, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-3


def test_deviations_are_those_declared_and_the_pose_of_the_base_stays(body: models.WholeBody) -> None:
    x = body.state(joints="stand")
    spread = Spread(joints=0.03, joint_velocity=0.0, linear_velocity=0.2, angular_velocity=0.0)
    off = np.array([spread.around(body, x, seed) - x for seed in range(400)])
    where = body.state.slices
    for quantity, deviation in ((joints.position, 0.03), (base.linear_velocity, 0.2)):
        assert off[:, where[quantity]].std() == pytest.approx(deviation, rel=0.1)
    for quantity in (base.position, base.orientation, joints.velocity, base.angular_velocity):
        assert not np.any(off[:, where[quantity]])
    np.testing.assert_array_equal(STILL.around(body, x, 0), x)


@pytest.mark.parametrize("bad", [-0.1, float("nan"), float("inf"), True, "wide"])
def test_a_deviation_is_a_number_from_zero_on(bad: object) -> None:
    with pytest.raises(SamplingError, match="spread: joints is out of range - got .*, expected a standard deviation"):
        Spread(joints=bad)  # type: ignore[arg-type]
