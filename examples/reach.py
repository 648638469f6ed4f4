"""Panda, an arm on a table, moves its hand from one side of a box to the other, within its limits."""

import argparse
import math
from pathlib import Path

import casadi as cs
import pinocchio
from example_robot_data.robots_loader import getModelPath

from piaffe import models, ocp, solvers
from piaffe.models import joints, stance

URDF = "panda_description/urdf/panda.urdf"
FINGERS = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}  # [m]; they mimic each other, and do not move here
robot = models.load(Path(getModelPath(URDF)) / URDF, base="fixed", locked=FINGERS, name="panda")
body = models.WholeBody(robot)

START = (0.6, 0.2, 0.0, -2.2, 0.0, 2.4, 0.8)  # [rad], hand to the left of the box
GOAL = (0.455, -0.312, 0.292)  # [m], to the right of it
CENTRE, HALF = (0.48, 0.0, 0.12), (0.15, 0.06, 0.12)  # [m], of the box
MARGIN = 0.04  # [m], half of the width of the hand
PARTS = ("panda_hand_tcp", "panda_hand", "panda_link7")


@ocp.residual(unit="m")
def hand_to_goal(s):
    """Return the hand relative to the goal, so that it does not come late."""
    return s.frames.panda_hand.position - cs.DM(GOAL)


@ocp.equality(unit="m", at="end")
def hand_at_goal(s):
    """Return the hand relative to the goal, zero at the end."""
    return s.frames.panda_hand.position - cs.DM(GOAL)


@ocp.equality(unit="rad/s", at="end")
def at_rest(s):
    """Return the joint velocities, which are zero at the end."""
    return s.joints.velocity


@ocp.inequality(lower=1.0)
def around_the_box(s):
    """Return where parts of the hand are, 1 on a rounded surface that contains the box and a margin."""
    size = [3**0.25 * half + MARGIN for half in HALF]  # the corners of the box are inside
    away = [
        [(s.frames[part].position[i] - CENTRE[i]) / size[i] for i in range(3)] for part in PARTS
    ]  # fmt: skip
    return [sum(each**4 for each in place) ** 0.25 for place in away]


reach = ocp.Motion(
    ocp.Phase("reach", stance(""), 1.6, ocp.Keyframe(joints=START)),  # [s]
    ocp.Phase("stay", stance(""), 0.2, ocp.Keyframe(joints=START)),
)
objective = ocp.Objective(
    ocp.regularize(joints.velocity, weight=0.1),
    ocp.regularize(joints.acceleration, weight=1e-3),
    ocp.regularize(joints.torque, weight=1e-5),
) + hand_to_goal.weighted(1.0)
limits = ocp.Constraints(
    models.torque_limits(), models.joint_limits(margin=0.02), models.joint_speed_limits(), around_the_box,
    hand_at_goal, at_rest,
)  # fmt: skip
problem = ocp.Problem(reach, body.until_end(dt=0.02), objective, limits, initial=body.state(joints=START))


def main() -> float:
    """Solve, and return the time that the motion takes until the hand stays within 1 cm of the goal [s]."""
    solution = solvers.MSiLQR(problem).solve().raise_if_failed()
    print(solution)
    away = [
        (float(t), math.dist(hand(x), GOAL))
        for phase in solution.trajectory.phases
        for t, x in zip(phase.times, phase.states, strict=True)
    ]
    arrived = max((t for t, distance in away if distance > 0.01), default=0.0)
    print(f"the hand is at the goal after {arrived:.2f} s")
    return arrived


def hand(x):
    """Return the place of the hand in a state, (3,) [m]."""
    q = pinocchio.neutral(robot.model)
    q[-robot.num_joints :] = x[: robot.num_joints]
    data = robot.model.createData()
    pinocchio.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.frame_id("panda_hand")].translation


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    main()
