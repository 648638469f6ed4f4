"""Mini Cheetah flips backwards: it rears, kicks off with its hind legs, turns in the air and lands on all feet."""

# Keyframes and weights were chosen on simulations of the policy with seeds from 1000 on:
# piaffe verify flip.npz examples/backflip.py --simulate --seeds 30 --first-seed 1000
# The step of 5 ms is for the landing: with 10 ms feet slip by 0.9 mm in it, and 1 mm is the bound.

from math import pi

import casadi as cs

from piaffe import models, ocp, solvers
from piaffe.models import base, joints, stance

robot = models.load("mini_cheetah")
body = models.WholeBody(robot)


@ocp.inequality(lower=0.03, unit="m", when=("rear", "kick", "land", "settle"))
def knee_clearance(s):
    """Keep the knees off the ground."""
    return cs.vertcat(*(s.frames[f"{leg}_KFE"].position[2] for leg in robot.foot_names))


four, hind, none = stance("FL FR HL HR"), stance("HL HR"), stance("")
flip = ocp.Motion(
    ocp.Phase("rear",   four, 0.16, ocp.Keyframe(position=(-0.06, 0, 0.22), rpy=(0, -pi / 8, 0), joints="crouch")),
    ocp.Phase("kick",   hind, 0.20, ocp.Keyframe(position=(-0.10, 0, 0.36), rpy=(0, -0.4 * pi, 0), joints="stand")),
    ocp.Phase("flight", none, 0.42, ocp.Keyframe(position=(-0.40, 0, 0.22), rpy=(0, -2 * pi, 0), joints="stand")),
    ocp.Phase("land",   four, 0.30, ocp.Keyframe(position=(-0.40, 0, 0.22), rpy=(0, -2 * pi, 0), joints="stand")),
    ocp.Phase("settle", four, 0.30, ocp.Keyframe(position=(-0.40, 0, 0.25), rpy=(0, -2 * pi, 0), joints="stand")),
)  # fmt: skip
objective = ocp.Objective(
    ocp.track(base.position, weight=(10, 1, 30)),
    ocp.track(base.orientation, weight=(2, 5, 2)),
    ocp.track(base.linear_velocity, weight=1.0),
    ocp.track(base.angular_velocity, weight=1.0),
    ocp.track(joints.position, weight=2.0),
    ocp.track(joints.velocity, weight=0.05),
    ocp.regularize(joints.acceleration, weight=1e-6),
    ocp.regularize(joints.torque, weight=0.05),
    ocp.track(base.position, weight=(10, 1, 50), at="phase_end"),
    ocp.track(base.orientation, weight=(5, 10, 5), at="phase_end"),
    ocp.track(joints.position, weight=1.0, at="phase_end"),
)
limits = ocp.Constraints(
    models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(), models.joint_speed_limits(),
    models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0), knee_clearance,
)  # fmt: skip
problem = ocp.Problem(flip, body.until_end(dt=0.005), objective, limits, initial=body.state(joints="stand"))

if __name__ == "__main__":
    solution = solvers.MSiLQR(problem).solve()
    print(solution)
