"""Warnings about what a motion asks of the ground: its start, flights and speeds between keyframes."""

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.models import joints, stance
from piaffe.models.ground_warnings import ground_warnings
from piaffe.models.postures import RobotState
from piaffe.models.terrain import Flat

ROBOT = models.load("solo12")
BODY = models.WholeBody(ROBOT)
HEIGHT = ROBOT.base_height("stand")
ALL, NONE = stance(roles="all"), stance("")
STAND = ocp.Keyframe(position=(0, 0, HEIGHT), joints="stand")


def warned(*phases, body=BODY, initial=None):
    objective = ocp.Objective(ocp.regularize(joints.torque, weight=0.1))
    start = body.state(joints="stand") if initial is None else initial
    return ocp.Problem(ocp.Motion(*phases), body.until_end(dt=0.05), objective, initial=start).warnings()


def test_feet_that_stand_at_the_start_are_on_the_ground():
    assert warned(ocp.Phase("stand", ALL, 0.2)) == []
    high = BODY.state(position=(0, 0, HEIGHT + 0.1), joints="stand")
    (warning,) = warned(ocp.Phase("stand", ALL, 0.2), initial=high)
    assert "standing foot is not on the ground - got FL 0.100 m above it, FR 0.100 m above it" in warning.text
    assert warned(ocp.Phase("fall", NONE, 0.2), initial=high) == []


def test_the_ground_is_that_of_the_model():
    raised = Flat(0.3)
    on_it = RobotState(BODY.state.blocks, ROBOT, raised)(joints="stand")
    for initial, count in ((on_it, 0), (BODY.state(position=(0.0, 0.0, HEIGHT), joints="stand"), 1)):
        motion = ocp.Motion(ocp.Phase("stand", ALL, 0.2))
        path = motion.bind((BODY,), BODY.state.unpack(initial))
        found = list(ground_warnings(ROBOT, raised, BODY.resolve, path))
        assert len(found) == count
    assert "FL 0.300 m below it" in found[0].text


@pytest.mark.parametrize(("durations", "long"), [((0.5, 0.45), False), ((0.5, 0.6), True), ((1.2,), True)])
def test_a_flight_of_more_than_a_second_is_reported_with_its_rise(durations, long):
    flight = [ocp.Phase(f"up {i}", NONE, each) for i, each in enumerate(durations)]
    found = warned(ocp.Phase("push", ALL, 0.2), *flight, ocp.Phase("land", ALL, 0.2))
    assert len(found) == long
    if long:
        length = sum(durations)
        assert f"got {length:g} s without contact" in found[0].text
        assert f"rise by {9.81 * (length / 2) ** 2 / 2:.2f} m" in found[0].text
        assert "phase 'up 0'" in found[0].where


def test_a_keyframe_that_is_too_far_is_reported_with_the_speed():
    limit = 3 * sqrt(9.81 * HEIGHT)
    near, far = 0.9 * limit * 0.2, 1.1 * limit * 0.2
    for way, count in ((near, 0), (far, 1)):
        at = ocp.Keyframe(position=(way, 0, HEIGHT), joints="stand")
        found = warned(ocp.Phase("stand", ALL, 0.2, STAND), ocp.Phase("go", NONE, 0.2, at))
        assert len(found) == count
    assert f"{far / 0.2:.3g} m/s, expected at most {limit:.3g} m/s" in found[0].text


def test_a_robot_whose_knees_have_no_motors_is_described():
    body = models.WholeBody(replace(ROBOT, torque_limit=np.tile([17.0, 17.0, 0.0], 4)))
    (warning,) = warned(ocp.Phase("stand", ALL, 0.2, STAND), body=body)
    assert "static torque beyond the limit" in warning.text
