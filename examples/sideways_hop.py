"""Mini Cheetah hops 30 cm to its left and turns by a quarter in the air."""

from math import pi

from piaffe import models, ocp, solvers
from piaffe.models import base, joints, stance

robot = models.load("mini_cheetah")
body = models.WholeBody(robot)
all_feet = stance("FL FR HL HR")
high = robot.base_height("stand")  # of the base above the ground [m]
quarter = (0, 0, pi / 2)

leaning = ocp.Keyframe(position=(0, 0.05, high + 0.05), rpy=(0, 0, 0.2), feet=robot.forward_kinematics("stand"))
landed = ocp.Keyframe(position=(0, 0.30, high), rpy=quarter, joints="stand")
hop = ocp.Motion(
    ocp.Phase("push", all_feet, 0.25, leaning),
    ocp.Phase("flight", stance(""), 0.35, landed),
    ocp.Phase("land", all_feet, 0.30, landed),
)
objective = ocp.Objective(
    ocp.track(base.position, weight=10),
    ocp.track(base.orientation, weight=10),
    ocp.track(base.linear_velocity, weight=1),
    ocp.track(joints.position, weight=1),
    ocp.regularize(joints.velocity, weight=0.05),
    ocp.regularize(joints.torque, weight=0.01),
    ocp.track(base.position, weight=(10, 20, 10), at="phase_end"),
)
limits = ocp.Constraints(
    models.friction_cone(mu=0.6), models.torque_limits(0.9), models.joint_limits(), models.joint_speed_limits(),
    models.foot_clearance(minimum=0.0),
)  # fmt: skip
problem = ocp.Problem(hop, body.until_end(dt=0.01), objective, limits, initial=body.state(joints="stand"))


def main() -> float:
    """Solve the hop and return how far the robot has turned [rad]."""
    solution = solvers.MSiLQR(problem).solve().raise_if_failed()
    print(solution)
    return float(models.measures.turns(solution.trajectory)[2])


if __name__ == "__main__":
    print(f"turned {main():.3f} rad")
