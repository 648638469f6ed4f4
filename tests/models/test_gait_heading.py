"""The heading that a gait keeps while plans begin at measured states."""

import numpy as np
import pytest

from piaffe.models import base, feet, gaits, joints
from piaffe.ocp import rotation
from tests.gaits import GaitPair, disturbed, model_of

TICK = 0.02  # [s]


def turned_by(x, angle):
    """The state (nx,) with the base turned about the vertical axis through it."""
    turned = x.copy()
    turned[3:7] = rotation.np_multiply(rotation.np_from_rpy(np.array([0.0, 0.0, angle])), x[3:7])
    return turned


def within_half_turn(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


class Walker:
    """A gait of Mini Cheetah that advances from tick to tick with a base whose heading the test decides."""

    def __init__(self, heading, **options):
        self.model = model_of("mini_cheetah")
        motion = gaits.trot(0.3, ramp=0.0, intro=0.0, **options)
        x = self.model.state(joints="stand", rpy=(0.0, 0.0, heading))
        self.pair, self.now = GaitPair(self.model, motion, np.random.default_rng(0), x), 0.0

    @property
    def kept(self):
        return float(self.pair.memory[2])

    def measure(self, heading, dt=TICK, command=None):
        x = self.model.state(joints="stand", rpy=(0.0, 0.0, heading))
        self.pair.advance(self.now, dt, x, self.pair.phase(self.now + dt), command)
        self.now += dt


@pytest.mark.parametrize("limit", [0.0, 0.05, 0.15, 0.4])
@pytest.mark.parametrize("gait", ["trot", "bound"])
def test_functions_keep_the_heading_of_the_anchored_gait(gait, limit):
    """Headings are near the path, or anywhere; they pass the half turn, where angles jump."""
    rng = np.random.default_rng([int(100 * limit), len(gait)])
    pair, now = GaitPair.random(model_of("mini_cheetah"), gait, rng, heading_limit=limit, yaw_rate=0.8), 0.0
    near = 0
    for k in range(20):
        later, interval = pair.some_time(rng, now, now + rng.choice([TICK, 0.3]))
        x, actual = disturbed(pair, later, rng)
        angle = rng.uniform(-np.pi, np.pi) if k % 3 == 0 else rng.normal(scale=0.1)
        x = turned_by(x, angle)
        actual |= {base.orientation: x[3:7]}
        legs, angles = pair.numpy.kinematics, actual[joints.position]
        actual[feet.position] = legs.world_feet(actual[base.position], x[3:7], angles).ravel()
        pair.advance(now, later - now, x, interval)
        pair.numpy, now = pair.numpy.anchored(later, actual), later
        off = abs(within_half_turn(float(pair.memory[2]) - float(rotation.np_to_rpy(x[3:7])[2])))
        assert off <= limit + 1e-12
        near += off < limit - 1e-9
        for _ in range(2):
            pair.check(*pair.some_time(rng, now, now + 1.5), now)
    assert (near > 5) == (limit > 0.1)


@pytest.mark.parametrize("rate", [0.3, -0.5])
def test_a_robot_that_turns_too_slowly_is_behind_by_an_angle_that_does_not_grow(rate):
    """It turns at 0.9 of the commanded rate, and at 2 rad/s for each radian that it is behind its target."""

    def behind(limit):
        walker, heading, found = Walker(0.0, yaw_rate=rate, heading_limit=limit), 0.0, []
        for k in range(1500):
            found.append(k * TICK * rate - heading)
            heading += TICK * (0.9 * rate + 2.0 * within_half_turn(walker.kept - heading))
            walker.measure(heading)
        return np.array(found)

    kept, measured = behind(0.15), behind(0.0)
    assert kept[500:] == pytest.approx(0.1 * rate / 2.0, rel=1e-3)  # 0.9 rate + 2 lag = rate
    assert measured[-1] == pytest.approx(0.1 * rate * 1499 * TICK, rel=1e-6)


@pytest.mark.parametrize("heading", [0.0, 3.0, -3.1])
@pytest.mark.parametrize("push", [0.8, -0.8, 2.5])
def test_after_a_push_the_kept_heading_is_within_its_limit_and_goes_on_from_there(heading, push):
    walker = Walker(heading, yaw_rate=0.2, heading_limit=0.1)
    walker.measure(heading)
    assert within_half_turn(walker.kept - heading) == pytest.approx(0.2 * TICK, abs=1e-12)
    walker.measure(heading + push)
    assert within_half_turn(walker.kept - heading - push) == pytest.approx(-np.sign(push) * 0.1, abs=1e-12)
    assert abs(walker.kept) <= np.pi
    back = walker.kept
    for _ in range(50):  # the robot is back at once; the rest of the push is forgotten
        walker.measure(back)
    assert within_half_turn(walker.kept - back) == pytest.approx(min(50 * TICK * 0.2, 0.1), abs=1e-9)


def test_the_kept_heading_passes_the_half_turn():
    walker = Walker(3.1, yaw_rate=1.0, heading_limit=0.15)
    for k in range(1, 8):
        walker.measure(3.1 + (k * TICK if k < 4 else 3 * TICK))
        assert within_half_turn(walker.kept - 3.1 - k * TICK) == pytest.approx(0.0, abs=1e-12)
    assert walker.kept < -3.0


def test_the_heading_follows_commands_that_change_and_ticks_that_are_missing():
    walker = Walker(0.0, yaw_rate=0.3, heading_limit=np.pi)
    slow, fast = ((0.3, 0.0, rate, walker.pair.functions.command[3]) for rate in (0.3, 0.5))
    walker.measure(0.0, 0.1, slow)
    assert walker.kept == pytest.approx(0.03, abs=1e-12)
    walker.measure(0.0, TICK, fast)  # the new command counts from this tick on
    assert walker.kept == pytest.approx(0.036, abs=1e-12)
    walker.measure(0.0, 1.0, fast)
    assert walker.kept == pytest.approx(0.536, abs=1e-12)


def test_targets_turn_from_the_kept_heading_on_with_feet_where_they_are():
    walker = Walker(0.0, yaw_rate=0.0, heading_limit=0.15)
    walker.measure(0.1)
    pair, now = walker.pair, walker.now
    target = pair.sample(now, pair.phase(now), now)
    assert rotation.np_to_rpy(target[base.orientation])[2] == pytest.approx(0.0, abs=1e-12)
    assert target[base.linear_velocity][:2] == pytest.approx([0.3, 0.0], abs=1e-12)  # ahead is the kept heading's
    x = walker.model.state(joints="stand", rpy=(0.0, 0.0, 0.1))
    standing = pair.model.flags(pair.phase(now).phase.mode) > 0
    measured = pair.numpy.kinematics.world_feet(x[:3], x[3:7], pair.model.robot.pose("stand"))
    places = np.reshape(pair.memory.full().ravel()[22:], (4, 3))
    assert places[standing, :2] == pytest.approx(measured[standing, :2], abs=1e-9)
