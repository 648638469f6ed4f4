"""Gaits in NumPy beside their functions, for tests that compare them or follow them over time."""

from functools import cache
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.models import base, feet, gaits, joints
from piaffe.ocp import rotation
from piaffe.ocp.compiler.added import with_added


@cache
def robot_of(name):
    if name == "biped":
        return models.load(Path(__file__).parents[1] / "examples" / "biped.urdf", feet="L_FOOT R_FOOT")
    return models.load(name)


@cache
def model_of(name, kind=models.WholeBody):
    return kind(robot_of(name))


def begin_state(model, rng):
    state = {
        "position": (*rng.uniform(-2, 2, 2), 0.97 * model.robot.base_height("stand")),
        "rpy": (*rng.uniform(-0.05, 0.05, 2), rng.uniform(-3, 3)),
        "linear_velocity": (*rng.uniform(-0.2, 0.2, 2), 0.0),
        "angular_velocity": (0.0, 0.0, rng.uniform(-0.3, 0.3)),
    }
    return model.state(**state)


class GaitPair:
    """A gait in NumPy and its functions, begun at a state; some numbers are random."""

    def __init__(self, model, motion, rng, x=None):
        self.model, self.motion = model, motion
        x = begin_state(model, rng) if x is None else x
        self.numpy = motion.bind((model,), model.state.unpack(x)).placed[0].reference
        self.functions = self.numpy.functions()
        self.path = with_added(motion.bind((model,), model.state.unpack(x)), [model], "test")
        self.anchor = ocp.ORIGIN  # of the frame of the functions, in which the gait is
        self.intervals = list(takewhile(lambda interval: interval.start < 40.0, motion.intervals()))
        self.memory = self.placed(self.functions.begin, self.functions.start(x), self.functions.command)

    @staticmethod
    def random(model, gait, rng, **options):
        slow = 0.4 if model.robot.base_height("stand") < 0.26 else 1.0
        command = {
            "speed": slow * rng.uniform(-0.3, 0.6),
            "lateral_speed": slow * rng.uniform(-0.15, 0.15),
            "yaw_rate": slow * rng.uniform(-0.8, 0.8),
            "ramp": rng.choice([0.0, 0.3, 1.0, 2.0]),
            "intro": rng.choice([0.0, 0.05]),
            **options,
        }
        return GaitPair(model, getattr(gaits, gait)(**command), rng)

    def placed(self, function, *inputs):
        return function(*inputs, self.anchor) if self.functions.in_world else function(*inputs)

    def phase(self, t):
        return next(i for i in reversed(self.intervals) if i.start <= t + ocp.SAME_TIME)

    def row(self, interval, now):
        return interval.start - now, self.functions.schedule(interval.index)

    def sample(self, t, interval, now=0.0):
        functions = self.functions
        values = self.placed(functions.sample, t - now, self.memory, *self.row(interval, now)).full().ravel()
        ends = np.cumsum([size for _, size in self.functions.quantities])
        return dict(zip([q for q, _ in self.functions.quantities], np.split(values, ends[:-1]), strict=True))

    def advance(self, now, dt, x, interval, command=None):
        """Go from now to now + dt; interval is a phase at the latter time."""
        command = self.functions.command if command is None else command
        row = self.row(interval, now + dt)
        self.memory = self.placed(self.functions.advance, self.memory, dt, x, command, *row)

    def expected(self, t, interval):
        sample = {quantity: values[0] for quantity, values in self.numpy.samples(np.array([t])).items()}
        sample[feet.force] = self.numpy.sample(t, interval.index)[feet.force]
        for added in self.path.added:
            planes = added.at(t, interval, sample)
            sample |= {feet.height: planes[feet.height]}
            sample |= {quantity: planes[quantity] for quantity in (feet.surfaces, feet.normals)}
        return sample

    def check(self, t, interval, now=0.0):
        """Compare all targets at a time; angles with the exact solution, if there is one."""
        got, expected = self.sample(t, interval, now), self.expected(t, interval)
        assert list(got) == list(expected)
        for quantity, value in got.items():
            wanted = np.ravel(expected[quantity])
            if quantity is base.orientation:
                value = value * np.sign(value @ wanted)
            if quantity is feet.surfaces:  # a plane has many points
                normals = got[feet.normals].reshape(-1, 3)
                value, wanted = (np.sum(each.reshape(-1, 3) * normals, axis=1) for each in (value, wanted))
            if quantity not in (joints.position, joints.velocity):
                assert value == pytest.approx(wanted, abs=1e-9), f"{quantity} at {t}"
            assert np.isfinite(value).all()
        legs, place = self.numpy.kinematics, expected[feet.position].reshape(-1, 3)
        pose = expected[base.position], expected[base.orientation]
        angles, miss = legs.world_inverse(*pose, place, tolerance=1e-14)
        if miss.max() > 1e-12:
            return 0
        assert got[joints.position] == pytest.approx(angles, abs=1e-9), f"angles at {t}"
        inward = rotation.np_matrix(pose[1]).T
        arms = (place - pose[0]) @ inward.T
        speeds = expected[feet.velocity].reshape(-1, 3) - expected[base.linear_velocity]
        relative = speeds @ inward.T - np.cross(expected[base.angular_velocity], arms)
        rates = legs.joint_velocities(angles[None], relative[None])[0]
        assert got[joints.velocity] == pytest.approx(rates, abs=1e-9 * max(1.0, np.abs(rates).max())), f"rates at {t}"
        return 1

    def some_time(self, rng, first, last):
        """Return a time, now and then on a boundary, and a phase on one of its sides."""
        t = rng.uniform(first, last)
        if rng.uniform() < 0.3:
            t = max(self.phase(t).start, first)
        interval = self.phase(t)
        if rng.uniform() < 0.5 and abs(t - interval.start) < 1e-12 and interval.index:
            interval = self.intervals[interval.index - 1]
        return t, interval


def disturbed(pair, t, rng):
    """Return a state near the reference at time t, and the same as a sample with measured feet."""
    sample, state = pair.numpy.samples(np.array([t])), pair.model.state
    position = sample[base.position][0] + 0.01 * rng.normal(size=3)
    turn = rotation.np_exp(0.03 * rng.normal(size=3))
    values = {
        base.position: position,
        base.orientation: rotation.np_multiply(sample[base.orientation][0], turn),
        joints.position: sample[joints.position][0] + 0.02 * rng.normal(size=pair.model.robot.num_joints),
        base.linear_velocity: sample[base.linear_velocity][0] + 0.1 * rng.normal(size=3),
        base.angular_velocity: rng.normal(size=3),
        joints.velocity: sample[joints.velocity][0],
    }
    x = np.concatenate([values[block.quantity] for block in state.blocks])
    actual = dict(state.unpack(x))
    if joints.position in actual:
        actual[feet.position] = pair.numpy.kinematics.world_feet(
            position, actual[base.orientation], actual[joints.position]
        ).ravel()
    return x, actual
