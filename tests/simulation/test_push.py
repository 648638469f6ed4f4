"""Pushes and commands: what they change, and how they are written."""

import re
from math import pi
from typing import Any

import mujoco
import numpy as np
import pytest

from piaffe.errors import ModelError
from piaffe.models import Fall
from piaffe.simulation import Command, Plant, Push, parse_commands, parse_pushes, run_online, torque_plant
from tests.simulation.online import STAND, Angles, Springs
from tests.simulation.plans import BODY, ROBOT

HIGH = BODY.state(joints="stand", position=(0, 0, 3.0))
NEVER = Fall(tilt=pi, height=-np.inf)


def flown(*pushes: Push, initial: np.ndarray = HIGH, seconds: float = 0.1) -> np.ndarray:
    """Return the last state of a flight with limp joints minus that without pushes."""
    low = Springs(Angles(STAND))
    low.control = lambda x, t: np.zeros(12)  # type: ignore[method-assign]
    runs = [
        run_online(None, low, Plant(ROBOT), seconds=seconds, initial=initial, pushes=each, fall=NEVER)
        for each in (pushes, ())
    ]
    return np.asarray(runs[0].last - runs[1].last)


def test_a_push_changes_the_velocity_of_the_whole_robot_in_its_duration() -> None:
    change = flown(Push(time=0.02, velocity=(1.0, -0.5, 0.25), frame="world"))
    np.testing.assert_allclose(change[19:22], (1.0, -0.5, 0.25), atol=1e-6)
    np.testing.assert_allclose(change[22:], 0.0, atol=1e-6)  # neither turn nor joint speeds
    np.testing.assert_allclose(change[7:19], 0.0, atol=1e-6)
    # equal steps from 20 to 70 ms: on average they act for 0.1 - 0.045 + half a step
    np.testing.assert_allclose(change[:3], np.array((1.0, -0.5, 0.25)) * (0.055 + 0.0005), atol=1e-6)
    half = flown(Push(time=0.02, velocity=(1.0, 0.0, 0.0), frame="world"), seconds=0.045)
    assert half[19] == pytest.approx(0.5, abs=1e-6)


def test_a_push_is_in_the_axes_of_the_base_or_of_the_world() -> None:
    turned = BODY.state(joints="stand", position=(0, 0, 3.0), rpy=(0, 0, pi / 2))
    push = {"time": 0.0, "velocity": (1.0, 0.0, 0.0)}
    np.testing.assert_allclose(flown(Push(**push), initial=turned)[19:22], (0, 1, 0), atol=1e-6)  # type: ignore[arg-type]
    world = Push(**push, frame="world")  # type: ignore[arg-type]
    np.testing.assert_allclose(flown(world, initial=turned)[19:22], (1, 0, 0), atol=1e-6)
    spinning = BODY.state(joints="stand", position=(0, 0, 3.0), angular_velocity=(0, 0, 0.5 / 0.05))
    change = flown(Push(**push), initial=spinning)  # type: ignore[arg-type]
    mean = np.sin(0.5) / 0.5, (1 - np.cos(0.5)) / 0.5  # of the base's x axis over a turn by 0.5 rad
    np.testing.assert_allclose(change[19:21], mean, atol=0.02)


def test_a_force_changes_the_momentum_by_its_impulse() -> None:
    push, low = Push(time=0.01, force=(10.0, 0.0, -5.0), duration=0.02, frame="world"), Springs(Angles(STAND))
    model, momenta = torque_plant(ROBOT).compiled(), []
    for pushes in ((push,), ()):
        made = run_online(None, low, Plant(ROBOT), seconds=0.2, initial=HIGH, fall=NEVER, pushes=pushes)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = made.last[:19], made.last[19:]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        momenta.append(data.subtree_linvel[1] * ROBOT.mass)
    np.testing.assert_allclose(momenta[0] - momenta[1], np.array((10.0, 0.0, -5.0)) * 0.02, atol=1e-4)


def test_pushes_have_a_text_form() -> None:
    assert parse_pushes("1.5@2.7:y") == (Push(time=2.7, velocity=(0.0, 1.5, 0.0)),)
    assert parse_pushes("-1.5@2.7:x  2@4:z/0.1") == (
        Push(time=2.7, velocity=(-1.5, 0.0, 0.0)),
        Push(time=4.0, velocity=(0.0, 0.0, 2.0), duration=0.1),
    )
    assert parse_pushes(["-60N@0.5:x", "1e-1@.5:y"])[0] == Push(time=0.5, force=(-60.0, 0.0, 0.0))
    assert parse_pushes("") == ()


@pytest.mark.parametrize(
    "word", ["1.5", "1.5@2.7", "1.5@2.7:w", "fast@2:y", "1.5@2.7:y/", "@2:y", "1.5@2.7:yy", "nan@1:x"]
)
def test_texts_that_are_no_pushes_are_refused(word: str) -> None:
    with pytest.raises(
        ModelError, match=re.escape(f"push: text is unusable - got {word!r}, expected a push as '1.5@2.7:y'")
    ):
        parse_pushes(word)


@pytest.mark.parametrize(
    ("push", "text"),
    [
        ({"time": -0.1, "velocity": (1, 0, 0)}, "push: time or duration is out of range - got -0.1 and 0.05"),
        ({"time": 0.1, "velocity": (1, 0, 0), "duration": 0.0}, "push: time or duration is out of range"),
        ({"time": np.nan, "velocity": (1, 0, 0)}, "push: time is not a number - got nan"),
        ({"time": 0.1}, "push at 0.1 s: it is not one thing - got velocity=None and force=None"),
        ({"time": 0.1, "velocity": (1, 0, 0), "force": (1, 0, 0)}, "push at 0.1 s: it is not one thing"),
        ({"time": 0.1, "velocity": (1, 0)}, "push: velocity or force is not a vector - got (1, 0)"),
        ({"time": 0.1, "velocity": (1, 0, np.inf)}, "push: velocity or force is not a vector"),
        ({"time": 0.1, "velocity": (1, 0, 0), "frame": "foot"}, "push: frame is unknown - got 'foot'"),
    ],
)
def test_pushes_out_of_range_are_refused(push: dict[str, Any], text: str) -> None:
    with pytest.raises(ModelError, match=re.escape(text)):
        Push(**push)


def test_commands_have_a_text_form() -> None:
    assert parse_commands("vx=0.8@3 vx=0.5 yaw=-0.5@6 height=.2@3") == (
        Command(0.0, {"speed": 0.5}),
        Command(3.0, {"speed": 0.8, "height": 0.2}),
        Command(6.0, {"yaw_rate": -0.5}),
    )
    assert parse_commands("motion=pace@2 vx=0.1@2") == (Command(2.0, {"motion": "pace", "speed": 0.1}),)
    assert parse_commands("vy=0.1") == (Command(0.0, {"lateral_speed": 0.1}),)
    for word in ("vx", "vx=", "0.5@3", "vx=a", "vx=1@", "vx=1@b", "motion=1", "motion="):
        with pytest.raises(
            ModelError, match=re.escape(f"command: text is unusable - got {word!r}, expected name=value")
        ):
            parse_commands(word)
    with pytest.raises(ModelError, match="command: 'speed' has two values at one time - got 1 and 2"):
        parse_commands("vx=1@2 speed=2@2.0")


def test_commands_out_of_range_are_refused() -> None:
    with pytest.raises(ModelError, match="command: time is out of range - got -1"):
        Command(-1.0, {"vx": 1.0})
    with pytest.raises(ModelError, match="command: no values - got none"):
        Command(1.0, {})
    with pytest.raises(ModelError, match="command at 1 s: 'motion' is no name - got 3"):
        Command(1.0, {"motion": 3})
    with pytest.raises(ModelError, match="command: 'motion' has two values at one time - got trot and pace"):
        parse_commands("motion=trot@2 motion=pace@2")
    with pytest.raises(ModelError, match="command at 1 s: 'vx' is not a number - got inf"):
        Command(1.0, {"vx": np.inf})
