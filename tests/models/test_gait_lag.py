"""The lag that a gait makes up for while plans begin at measured states."""

import numpy as np
import pytest

from piaffe.models import base, feet, gaits, joints
from piaffe.ocp import rotation
from tests.gaits import GaitPair, disturbed, model_of

TICK = 0.02  # [s]


def memory_of(pair):
    return np.array(pair.memory).ravel()


@pytest.mark.parametrize("limit", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("gait", ["trot", "pronk"])
def test_functions_make_up_for_the_lag_of_the_anchored_gait(gait, limit):
    rng = np.random.default_rng([int(1000 * limit), len(gait)])
    model = model_of("mini_cheetah")
    pair, now = GaitPair.random(model, gait, rng, lag_gain=1.5, lag_limit=limit, yaw_rate=0.8, speed=0.6), 0.0
    limited = 0
    for _ in range(15):
        later, interval = pair.some_time(rng, now, now + rng.choice([TICK, 0.3]))
        x, actual = disturbed(pair, later, rng)
        legs, angles = pair.numpy.kinematics, actual[joints.position]
        actual[feet.position] = legs.world_feet(actual[base.position], x[3:7], angles).ravel()
        pair.advance(now, later - now, x, interval)
        pair.numpy, now = pair.numpy.anchored(later, actual), later
        lag = memory_of(pair)[20:22]
        assert np.allclose(lag, pair.numpy._lag, atol=1e-9)
        assert np.all(np.abs(lag) <= limit + 1e-12)
        limited += bool(np.any(np.abs(lag) > limit - 1e-12))
        for _ in range(2):
            pair.check(*pair.some_time(rng, now, now + 1.5), now)
    assert (limited > 3) == (limit < 0.05)


def walk(factor, *, drift=0.0, push=0.0, yaw_rate=0.2, seconds=12.0, **options):
    """Speeds, to the front and to the left, of a base that goes at a factor of its target and drifts to the left."""
    model = model_of("mini_cheetah")
    motion = gaits.trot(0.4, ramp=0.0, intro=0.0, yaw_rate=yaw_rate, **options)
    x = model.state(joints="stand", rpy=(0.0, 0.0, 0.7))
    pair, now, heading, found = GaitPair(model, motion, np.random.default_rng(0), x), 0.0, 0.7, []
    for k in range(round(seconds / TICK)):
        wanted = pair.sample(now, pair.phase(now), now)[base.linear_velocity][:2]
        c, s = np.cos(heading), np.sin(heading)
        local = np.array([c * wanted[0] + s * wanted[1], -s * wanted[0] + c * wanted[1]])
        local = factor * local + (0.0, drift) + (0.0, push if k == 100 else 0.0)
        x[:2] += TICK * np.array([c * local[0] - s * local[1], s * local[0] + c * local[1]])
        heading += TICK * yaw_rate
        x[3:7] = rotation.np_from_rpy(np.array([0.0, 0.0, heading]))
        x[19:21] = c * local[0] - s * local[1], s * local[0] + c * local[1]
        pair.advance(now, TICK, x, pair.phase(now + TICK))
        now += TICK
        found.append(local)
    return np.array(found)


def test_an_error_of_the_speed_stays_without_the_gain_and_goes_with_it():
    without, with_gain = walk(0.95, drift=0.01), walk(0.95, drift=0.01, lag_gain=1.0)
    assert np.allclose(without[-50:].mean(axis=0), (0.38, 0.01), atol=1e-3)
    assert np.allclose(with_gain[-50:].mean(axis=0), (0.4, 0.0), atol=1e-3)


def test_what_a_push_leaves_beyond_the_limit_is_forgotten():
    found = walk(1.0, push=50.0, yaw_rate=0.0, lag_gain=1.0, lag_limit=0.03)  # one metre to the left
    after = found[101:]
    assert after[:, 1].min() >= -0.03 - 1e-9  # the gait does not go back at more than gain times limit
    assert abs(TICK * after[:, 1].sum() + 0.03) < 2e-3  # nor farther than the limit
    assert np.allclose(after[-1], (0.4, 0.0), atol=1e-3)


def test_commands_are_those_of_the_user_also_while_a_lag_is_made_up_for():
    """The correction begins no ramp: the next command is compared with the last one."""
    model, rng = model_of("mini_cheetah"), np.random.default_rng(5)
    pair = GaitPair(model, gaits.trot(0.4, ramp=0.5, lag_gain=1.0), rng, model.state(joints="stand"))
    x = model.state(joints="stand")
    for k in range(40):
        pair.advance(TICK * k, TICK, x, pair.phase(TICK * (k + 1)))
    assert memory_of(pair)[9] == 0.0  # nothing is left of the ramp
    assert np.allclose(memory_of(pair)[6:9], (0.4, 0, 0))
    assert np.allclose(memory_of(pair)[20:22], (0.05, 0))  # the base stands still


@pytest.mark.parametrize(("name", "value"), [("lag_gain", -0.1), ("lag_gain", np.inf), ("lag_limit", np.nan)])
def test_numbers_out_of_range_are_refused(name, value):
    from piaffe.errors import ProblemError

    with pytest.raises(ProblemError, match=rf"gait: {name} is out of range - got {value}"):
        gaits.trot(**{name: value})
