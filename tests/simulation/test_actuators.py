"""Actuators: limits of torque and speed, delay, and what acts on a joint beside the torque."""

import re
from typing import Any

import mujoco
import numpy as np
import pytest

from piaffe import models
from piaffe.errors import ModelError
from piaffe.simulation import Actuators, Plant, mini_cheetah_actuators, run_online, torque_plant
from piaffe.simulation.actuators import Drive
from tests.simulation.online import STAND, Angles, Springs
from tests.simulation.plans import BODY, ROBOT

START = BODY.state(joints="stand")


def drive(limit: float, stall: float, speed: float, delay: int = 0) -> Drive:
    return Drive(np.full(1, limit), np.full(1, stall), np.full(1, speed), delay)


@pytest.mark.parametrize(
    ("command", "speed", "acting", "limited"),
    [
        (8.0, 0.0, 8.0, False),
        (12.0, 0.0, 10.0, True),
        (9.0, 4.0, 9.0, False),  # 20 (1 - 4/10) = 12 is more than the limit
        (9.0, 8.0, 4.0, True),  # 20 (1 - 8/10)
        (-9.0, 8.0, -9.0, False),  # against the motion
        (-12.0, 8.0, -10.0, True),
        (-9.0, -8.0, -4.0, True),
        (9.0, -8.0, 9.0, False),
        (5.0, 15.0, 0.0, True),  # faster than without load
        (-5.0, 15.0, -5.0, False),
    ],
)
def test_the_induced_voltage_limits_torques_in_the_direction_of_motion(
    command: float, speed: float, acting: float, limited: bool
) -> None:
    got, full = drive(10.0, 20.0, 10.0)(np.array([command]), np.array([speed]))
    assert got[0] == pytest.approx(acting)
    assert full[0] == limited


def test_without_limits_a_torque_is_what_was_commanded() -> None:
    got, full = drive(np.inf, np.inf, np.inf)(np.array([1e5]), np.array([50.0]))
    assert (got[0], full[0]) == (1e5, False)
    got, full = drive(np.inf, np.inf, 10.0)(np.array([1e5]), np.array([10.0]))
    assert (got[0], full[0]) == (1e5, False)


def test_a_command_acts_after_the_delay() -> None:
    delayed = drive(100.0, 100.0, np.inf, delay=3)
    got = [delayed(np.array([float(i)]), np.zeros(1))[0][0] for i in range(1, 8)]
    assert got == [1.0, 1.0, 1.0, 1.0, 2.0, 3.0, 4.0]


def test_the_published_limits_are_those_of_the_motors_voltage() -> None:
    robot = models.load("mini_cheetah", rotors=True)
    plant = Plant(robot, actuators=mini_cheetah_actuators())
    np.testing.assert_allclose(
        plant.scene.compiled.dof_armature[6:], np.tile([2.268e-3, 2.268e-3, 5.484e-3], 4), rtol=1e-3
    )
    np.testing.assert_array_equal(plant.torque_limit, np.tile([17.0, 17.0, 26.0], 4))
    made = Drive.of(mini_cheetah_actuators(), robot, plant.torque_limit, 1e-3)
    ratio = np.tile([6.0, 6.0, 9.33], 4)
    for speed in (0.0, 10.0, 22.0, 25.0, 36.0, 39.5):
        torque, _ = made(np.full(12, 1e3), np.full(12, speed))
        current = torque / ratio / (1.5 * 0.05)
        volt = 0.173 * current + 2 * 0.05 * ratio * speed
        at_limit = np.isclose(torque, plant.torque_limit)
        assert np.all(at_limit | (torque == 0) | np.isclose(volt, 24.0))
        assert np.all(volt[torque > 0] <= 24.0 + 1e-9)
    assert not at_limit.any()
    assert np.array_equal(torque > 0, ratio == 6.0)  # knees turn 25.7 rad/s without load, the others 40


def test_armature_damping_friction_and_limit_act_as_in_a_model_of_mujoco_with_these_numbers() -> None:
    numbers = {
        "armature": np.linspace(1e-3, 4e-3, 12), "damping": {"HAA": 0.01, "HFE": 0.05, "KFE": 0.03},
        "friction": np.linspace(0.05, 0.2, 12), "torque_limit": 1.2,
    }  # fmt: skip
    spec = torque_plant(ROBOT).spec()
    for i, name in enumerate(ROBOT.joint_names):
        joint = spec.joint(name)
        joint.armature, joint.frictionloss = numbers["armature"][i], numbers["friction"][i]  # type: ignore[index]
        joint.damping[:1] = [0.01, 0.05, 0.03][i % 3]
    bits = mujoco.mjtDisableBit
    spec.option.disableflags &= ~int(bits.mjDSBL_DAMPER | bits.mjDSBL_EULERDAMP | bits.mjDSBL_FRICTIONLOSS)
    model = spec.compile()
    models.restore_inertias(model, ROBOT)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = START[:19], START[19:]
    target = STAND + 0.3 * np.tile([0.0, 1.0, -1.0], 4)
    low, full = Springs(Angles(target)), []
    made = run_online(None, low, Plant(ROBOT, actuators=Actuators(**numbers)), seconds=0.1, tick=1e-3, initial=START)
    for _ in range(100):
        u = 6.0 * (target - data.qpos[7:]) - 0.15 * data.qvel[6:]
        full.append(np.abs(u) >= 1.2)
        data.ctrl[:] = np.clip(u, -1.2, 1.2)
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(made.last, np.concatenate([data.qpos, data.qvel]), atol=1e-8)
    np.testing.assert_array_equal(made.limited, full)
    assert 0 < made.limited.mean() < 1
    assert np.abs(made.torques).max() == 1.2
    assert made.excess()["torque"] == pytest.approx(np.abs(made.controls).max() - 1.2)
    free = run_online(None, Springs(Angles(target)), Plant(ROBOT), seconds=0.1, tick=1e-3, initial=START)
    assert np.abs(free.last - made.last).max() > 0.1  # the numbers matter


def test_a_delay_in_a_plant_is_that_of_its_commands() -> None:
    actuators = Actuators(delay=0.004)
    low = Springs(Angles(STAND + 0.2))
    made = run_online(None, low, Plant(ROBOT, actuators=actuators), seconds=0.05, tick=1e-3, initial=START)
    np.testing.assert_allclose(made.torques[4:], np.clip(made.controls[:-4], -ROBOT.torque_limit, ROBOT.torque_limit))
    assert np.abs(np.diff(made.controls, axis=0)).max() > 0.01


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        ({"damping": -0.1}, "actuators, damping of 'solo12': no number for joint 'FL_HAA' - got -0.1, expected"),
        ({"armature": np.inf}, "actuators, armature of 'solo12': no number"),
        ({"friction": {"HAA": 1.0}}, "actuators, friction of 'solo12': no number for joint 'FL_HFE'"),
        ({"friction": [1.0, 2.0]}, "actuators, friction of 'solo12': no number for joint 'FL_HAA'"),
        ({"torque_limit": np.nan}, "actuators, torque_limit of 'solo12': no number"),
        ({"no_load_speed": -1.0}, "actuators, no_load_speed of 'solo12': no number"),
        ({"stall_torque": "much"}, "actuators, stall_torque of 'solo12': no number for joint 'FL_HAA' - got 'much'"),
        ({"delay": 0.0015}, "actuators: delay is out of range - got 0.0015 s, expected a multiple of 0.001 s"),
        ({"delay": -0.001}, "actuators: delay is out of range - got -0.001, expected seconds ≥ 0"),
        ({"delay": None}, "actuators: delay is not a number - got None"),
    ],
)  # fmt: skip
def test_numbers_out_of_range_are_refused(numbers: dict[str, Any], text: str) -> None:
    with pytest.raises(ModelError, match=re.escape(text)):
        Plant(ROBOT, actuators=Actuators(**numbers))
