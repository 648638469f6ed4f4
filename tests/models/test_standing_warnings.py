"""Warnings about keyframes whose base moves away from feet that stay, and about states of other robots."""

import itertools

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.models import joints, stance
from tests.robots import ROBOTS

OBJECTIVE = ocp.Objective(ocp.regularize(joints.torque, weight=0.1), ocp.regularize(joints.velocity, weight=0.1))
ALL, NONE = stance(roles="all"), stance("")


@pytest.fixture(scope="module")
def body():
    return models.WholeBody(models.load("mini_cheetah"))


def warned(body, *phases, initial=None):
    start = body.state(joints="stand") if initial is None else initial
    problem = ocp.Problem(ocp.Motion(*phases), body.until_end(dt=0.05), OBJECTIVE, initial=start)
    return [one for one in problem.warnings() if "feet that stand" in one.text]


def at(body, x, y=0.0, **more):
    return ocp.Keyframe(position=(x, y, body.robot.base_height("stand")), joints="stand", **more)


@pytest.mark.parametrize(
    ("where", "count"), [((0.12, 0.0), 0), ((0.5, 0.0), 1), ((-0.5, 0.0), 1), ((0.0, 0.1), 0), ((0.0, 0.45), 1)]
)
def test_a_base_that_moves_ahead_of_feet_that_stay_is_reported(body, where, count):
    found = warned(body, ocp.Phase("stand", ALL, 0.4), ocp.Phase("lean", ALL, 0.8, at(body, *where)))
    assert len(found) == count
    if count:
        (warning,) = found
        assert warning.where.startswith("phase 'lean' (")
        assert all(f"{foot} 0." in warning.text for foot in ("FL", "HR"))


def test_the_distance_is_that_from_the_leg_s_reach(body):
    """With straight legs below the hips: sqrt(x² + h²) - reach, for a base that moves along x."""
    (warning,) = warned(body, ocp.Phase("go", ALL, 0.8, at(body, 0.9)))
    missed = float(warning.text.split("got FL ")[1].split(" m")[0])
    legs, robot = models.Kinematics(body.robot), body.robot
    places = legs.feet(robot.pose("stand"))[0]
    hip = robot.model.jointPlacements[2].translation + robot.model.jointPlacements[3].translation
    away = np.linalg.norm(places - (0.9, 0, 0) - hip)
    assert missed == pytest.approx(away - legs.reach[0], abs=0.03)  # the hip turns about a second axis


def test_feet_that_are_lifted_in_between_may_land_elsewhere(body):
    far = at(body, 0.5)
    hop = (
        ocp.Phase("push", ALL, 0.3, at(body, 0.0)),
        ocp.Phase("fly", NONE, 0.2, far),
        ocp.Phase("land", ALL, 0.3, far),
    )
    assert warned(body, *hop) == []
    after = warned(body, *hop, ocp.Phase("back", ALL, 0.5, at(body, 0.0)))
    assert [one.where.split(" (")[0] for one in after] == ["phase 'back'"]


def test_one_foot_that_stays_is_enough(body):
    step = (ocp.Phase("lift", stance("HL"), 0.4, at(body, 0.4)), ocp.Phase("stand", ALL, 0.2))
    (warning,) = warned(body, *step)
    assert "got HL 0." in warning.text
    assert "FL" not in warning.text


@pytest.mark.parametrize(("own", "other"), list(itertools.permutations(ROBOTS, 2)))
def test_a_state_of_another_robot_is_reported(own, other):
    body = models.WholeBody(models.load(own))
    state = models.WholeBody(models.load(other)).state(joints="stand")
    if state.shape != body.state(joints="stand").shape:
        pytest.skip("has another size, which is refused")
    stand = ocp.Motion(ocp.Phase("stand", ALL, 0.2))
    problem = ocp.Problem(
        stand, body.until_end(dt=0.05), OBJECTIVE, ocp.Constraints(models.joint_limits()), initial=state
    )
    assert problem.warnings()
