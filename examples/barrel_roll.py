"""Mini Cheetah rolls over sideways: six phases, a keyframe each."""

from math import pi

from piaffe import models, ocp, solvers
from piaffe.models import base, joints, stance

robot = models.load("mini_cheetah")
body = models.WholeBody(robot)

roll = ocp.Motion(
    ocp.Phase("push",   stance("FL FR HL HR"), 0.12, ocp.Keyframe(position=(0, -0.15, 0.26), rpy=(pi / 6, 0, 0), joints="crouch")),
    ocp.Phase("lean",   stance("FR HR"),       0.21, ocp.Keyframe(position=(0, -0.25, 0.33), rpy=(pi / 2, 0, 0), joints="lean")),
    ocp.Phase("flight", stance(""),            0.42, ocp.Keyframe(position=(0, -0.55, 0.22), rpy=(2 * pi, 0, 0), joints="tuck")),
    ocp.Phase("land",   stance("FL FR HL HR"), 0.15, ocp.Keyframe(position=(0, -0.55, 0.25), rpy=(2 * pi, 0, 0), joints="tuck")),
    ocp.Phase("hop",    stance(""),            0.20, ocp.Keyframe(position=(0, -0.55, 0.25), rpy=(2 * pi, 0, 0), joints="stand")),
    ocp.Phase("settle", stance("FL FR HL HR"), 0.15, ocp.Keyframe(position=(0, -0.55, 0.25), rpy=(2 * pi, 0, 0), joints="stand")),
)  # fmt: skip
objective = ocp.Objective(
    ocp.track(base.position, weight=(0, 1, 30)),
    ocp.track(base.orientation, weight=(5, 2, 2)),
    ocp.track(base.linear_velocity, weight=1.0),
    ocp.track(base.angular_velocity, weight=1.0),
    ocp.track(joints.position, weight=1.0),
    ocp.track(joints.velocity, weight=0.05),
    ocp.regularize(joints.torque, weight=0.05),
    ocp.track(base.position, weight=(0, 1, 50), at="phase_end"),
    ocp.track(base.orientation, weight=(10, 5, 5), at="phase_end"),
    ocp.track(joints.position, weight=1.0, at="phase_end"),
)
limits = ocp.Constraints(
    models.friction_cone(mu=0.6), models.torque_limits(0.9), models.joint_limits(), models.joint_speed_limits(),
    models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0),
)  # fmt: skip
problem = ocp.Problem(roll, body.until_end(dt=0.01), objective, limits, initial=body.state(joints="stand"))

if __name__ == "__main__":
    solution = solvers.MSiLQR(problem).solve()
    print(solution)
