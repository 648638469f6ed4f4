"""Warnings about keyframes: flights that cannot be, feet off the ground, joints and torques beyond their limits."""

from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from piaffe import models, ocp
from piaffe.models import base, joints, stance
from piaffe.models.warnings import static_torques

FILE = Path(__file__).name
ROBOT = models.load("mini_cheetah")
BODY = models.WholeBody(ROBOT)
STANDING = ROBOT.base_height("stand")
ALL, NONE = stance("FL FR HL HR"), stance("")


def warned(*phases, body=BODY, initial=None, motion=None):
    """Return the warnings about a motion as (place, text) pairs."""
    motion = motion or ocp.Motion(*phases)
    objective = ocp.Objective(ocp.regularize(joints.torque, weight=0.1))
    schedule = body.until_end(dt=0.01)
    start = body.state() if initial is None else initial
    compiled = ocp.compile_problem(ocp.Problem(motion, schedule, objective, initial=start))
    return [(warning.where, warning.text) for warning in ocp.find_warnings(compiled)]


def keyframe(name, mode, duration, **values):
    return ocp.Phase(name, mode, duration, ocp.Keyframe(**values))


def test_a_pose_on_the_ground_gives_no_warning():
    assert warned(keyframe("stand", ALL, 0.1, position=(0, 0, STANDING), joints="stand")) == []


def test_a_keyframe_without_a_posture_gives_no_warning():
    assert warned(keyframe("stand", ALL, 0.1, linear_velocity=(0, 0, 3))) == []


# ---- feet


def test_a_stance_foot_off_the_ground():
    phase = keyframe("stand", ALL, 0.1, position=(0, 0, STANDING + 0.05))
    ((where, text),) = warned(phase)
    assert where == f"phase 'stand' ({FILE}:{phase.source.line}), keyframe"
    assert text == (
        "stance foot is not on the ground - got FL 0.050 m above it, FR 0.050 m above it, HL 0.050 m above it, HR "
        "0.050 m above it, expected within 0.02 m; change the position of the base or the joint angles (feet= finds "
        "them)"
    )


def test_only_standing_feet_are_checked():
    rolled = keyframe("lean", stance("FR HR"), 0.1, position=(0, 0, STANDING), rpy=(0.3, 0, 0))
    ((_, text),) = warned(rolled)
    assert "FL" not in text
    assert "FR" in text
    assert "below it" in text


def test_a_foot_that_lands_off_the_ground():
    push = keyframe("push", ALL, 0.1, position=(0, 0, STANDING))
    hop = keyframe("hop", NONE, 0.1, position=(0, 0, STANDING + 0.03))
    ((where, text),) = warned(push, hop, ocp.Phase("land", stance("FL HR"), 0.1))
    assert where.startswith("phase 'hop'")
    assert text.startswith("landing foot is not on the ground - got FL 0.030 m above it, HR 0.030 m above it, expected")
    assert text.endswith("(feet= finds them), or give the model its ground, terrain=")


def test_a_foot_at_the_limit_gives_no_warning():
    assert warned(keyframe("stand", ALL, 0.1, position=(0, 0, STANDING + 0.02))) == []
    assert len(warned(keyframe("stand", ALL, 0.1, position=(0, 0, STANDING + 0.0201)))) == 1


def test_a_foot_in_the_air_may_be_anywhere():
    push = keyframe("push", ALL, 0.1, position=(0, 0, STANDING))
    assert warned(push, keyframe("fly", NONE, 0.1, position=(0, 0, STANDING + 0.3))) == []


# ---- joints


def test_a_joint_beyond_its_limit():
    bent = {"FL_HAA": 1.5, "HR_HAA": -1.4}
    stand = ocp.Phase("stand", ALL, 0.1)
    texts = [text for _, text in warned(stand, keyframe("bend", NONE, 0.1, joints=bent))]
    assert texts == [
        "joint beyond its limit - got FL_HAA at 1.500 rad, HR_HAA at -1.400 rad, expected -1.300 to 1.300 rad, -1.300 "
        "to 1.300 rad; change the angle"
    ]


# ---- torques


def weak(limit):
    return models.WholeBody(replace(ROBOT, torque_limit=np.full(12, limit)), name="weak")


def test_a_static_torque_beyond_the_limit():
    phase = keyframe("stand", ALL, 0.1, joints="stand")
    assert warned(phase) == []
    ((where, text),) = warned(phase, body=weak(1.0))
    assert where.startswith("phase 'stand'")
    assert text.startswith("static torque beyond the limit - got FL_KFE ")
    assert text.endswith(
        "Nm at rest on FL FR HL HR, expected at most 1.0 Nm, 1.0 Nm, 1.0 Nm, 1.0 Nm; straighten the legs or put "
        "more feet on the ground"
    )


def test_on_two_feet_it_takes_twice_as_much():
    phase = keyframe("stand", stance("FL HR"), 0.1, joints="stand")
    assert warned(phase, body=weak(8.0)) == []
    assert len(warned(phase, body=weak(5.0))) == 1
    assert warned(keyframe("stand", ALL, 0.1, joints="stand"), body=weak(5.0)) == []


def test_static_torques_balance_the_robot():
    """With the forces that go with them nothing accelerates."""
    q = pin.neutral(ROBOT.model)
    q[2], q[7:] = STANDING, ROBOT.pose("stand")
    torque = static_torques(ROBOT, q, ROBOT.foot_names)
    x = BODY.state()
    assert BODY.acceleration(x, torque, "FL FR HL HR", contact_damping=1e-6) == pytest.approx(np.zeros(18), abs=1e-3)


def test_static_torques_of_joints_without_limits():
    free = replace(ROBOT, torque_limit=np.full(12, np.inf))
    q = pin.neutral(free.model)
    q[2], q[7:] = STANDING, free.pose("stand")
    assert np.all(np.isfinite(static_torques(free, q, ("FL", "HR"))))


# ---- flights


def flight_height(start, end, share, duration):
    """Return the height on the flight between two heights, at a share of its duration [m]."""
    t = share * duration
    return start + share * (end - start) + 0.5 * 9.81 * t * (duration - t)


def test_two_keyframes_can_always_be_joined():
    push = keyframe("push", ALL, 0.1, position=(0, 0, STANDING))
    assert warned(push, keyframe("fly", NONE, 0.4, position=(1, 0, STANDING)), ocp.Phase("land", ALL, 0.1)) == []


def test_a_third_keyframe_in_one_flight_must_lie_on_it():
    push = keyframe("push", ALL, 0.1, position=(0, 0, STANDING), rpy=(0, 0, 0))
    top = flight_height(STANDING, STANDING, 0.5, 0.4)
    down = keyframe("down", NONE, 0.2, position=(0, 0, STANDING), rpy=(2 * pi, 0, 0))
    assert warned(push, keyframe("up", NONE, 0.2, position=(0, 0, top), rpy=(pi, 0, 0)), down) == []
    low = keyframe("up", NONE, 0.2, position=(0, 0, top - 0.1))
    ((where, text),) = warned(push, low, keyframe("down", NONE, 0.2, position=(0, 0, STANDING)))
    assert where == f"phase 'up' ({FILE}:{low.source.line}), keyframe"
    assert text.startswith("no ballistic flight joins the keyframes - got a height of ")
    assert "after 0.200 s in the air" in text
    assert text.endswith("0.100 m too low; move the keyframe or change the durations")


def test_a_flight_at_the_start_has_the_initial_velocity():
    at_rest = BODY.state(position=(0, 0, 1.0))
    fallen = 1.0 - 0.5 * 9.81 * 0.2**2
    assert warned(keyframe("fall", NONE, 0.2, position=(0, 0, fallen)), initial=at_rest) == []
    ((_, text),) = warned(keyframe("fall", NONE, 0.2, position=(0, 0, 1.0)), initial=at_rest)
    assert text.endswith("0.196 m too high; move the keyframe or change the durations")


def test_a_velocity_that_a_keyframe_gives_leaves_no_choice():
    jump = 9.81 * 0.2
    push = keyframe("push", ALL, 0.1, position=(0, 0, STANDING), linear_velocity=(0, 0, jump))
    land = ocp.Phase("land", ALL, 0.1)
    assert warned(push, keyframe("fly", NONE, 0.4, position=(0, 0, STANDING)), land) == []
    ((where, text),) = warned(push, keyframe("fly", NONE, 0.2, position=(0, 0, STANDING)), land)
    assert where.startswith("phase 'fly'")
    assert "0.196 m too low" in text
    hit = keyframe("fly", NONE, 0.4, position=(0, 0, STANDING), linear_velocity=(0, 0, -jump))
    assert warned(keyframe("push", ALL, 0.1, position=(0, 0, STANDING)), hit, land) == []
    slow = keyframe("fly", NONE, 0.4, position=(0, 0, STANDING), linear_velocity=(0, 0, -1.0))
    texts = [text for _, text in warned(keyframe("push", ALL, 0.1, position=(0, 0, STANDING)), slow, land)]
    assert len(texts) == 1
    assert texts[0].startswith("no ballistic flight joins")


# ---- where they apply


def test_gaits_have_no_keyframes():
    assert warned(motion=models.gaits.trot(speed=0.2).cycles(1)) == []
    endless = models.gaits.pronk(0.5)
    assert BODY.warnings(endless.bind((BODY,), BODY.state.unpack(BODY.state()))) == []


def test_keyframes_after_a_gait_are_checked():
    rest = ocp.Motion(keyframe("rest", ALL, 0.1, position=(0, 0, 0.1), joints="stand"))
    (first, *_) = warned(motion=models.gaits.trot(speed=0.2).cycles(1) + rest)
    assert first[0].startswith("phase 'rest'")


def test_two_models_of_one_robot_warn_once():
    rigid = models.SingleRigidBody(ROBOT)
    motion = ocp.Motion(keyframe("stand", ALL, 0.2, position=(0, 0, 0.5)))
    objective = ocp.Objective(ocp.regularize(joints.torque), ocp.regularize(models.feet.force))
    schedule = BODY.over(0.1, dt=0.05) + rigid.over(0.1, dt=0.05)
    compiled = ocp.compile_problem(ocp.Problem(motion, schedule, objective, initial=BODY.state()))
    assert [warning.text.split(" - ")[0] for warning in ocp.find_warnings(compiled)] == [
        "stance foot is not on the ground"
    ]


def test_flights_of_a_rigid_body_are_checked():
    rigid = models.SingleRigidBody(ROBOT)
    motion = ocp.Motion(keyframe("fall", NONE, 0.2, position=(0, 0, 1.0)))
    objective = ocp.Objective(ocp.regularize(models.feet.force), ocp.track(base.position))
    problem = ocp.Problem(motion, rigid.until_end(dt=0.05), objective, initial=rigid.state(position=(0, 0, 1.0)))
    (warning,) = ocp.find_warnings(ocp.compile_problem(problem))
    assert "no ballistic flight" in warning.text


def test_one_cycle_of_a_cyclic_motion_is_checked():
    hop = ocp.Motion(
        keyframe("stand", ALL, 0.1, position=(0, 0, 0.4)), keyframe("hop", NONE, 0.1, position=(0, 0, 0.3)), cyclic=True
    )
    objective = ocp.Objective(ocp.regularize(joints.torque))
    compiled = ocp.compile_problem(ocp.Problem(hop, BODY.over(0.4, dt=0.01), objective, initial=BODY.state()))
    assert [warning.where.split("'")[1] for warning in ocp.find_warnings(compiled)] == ["stand"]
