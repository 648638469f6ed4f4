"""Mini Cheetah squats under a bar, with user-defined terms: a residual, an inequality, an equality, a parameter."""

import argparse

from piaffe import models, ocp, solvers
from piaffe.models import base, joints, stance

robot = models.load("mini_cheetah")
body = models.WholeBody(robot)
ceiling = ocp.parameter("ceiling", 0.16)  # [m], height of the bar; a change does not compile anything


@ocp.residual(unit="rad")
def hip_symmetry(s):
    """Return the asymmetry of the front hips; s has the quantities of one node."""
    return s.joints.position["FL_HAA"] + s.joints.position["FR_HAA"]


@ocp.inequality(lower=0.10, unit="m")
def knee_clearance(s):
    """Return the heights of the knees, which stay above 0.10 m."""
    return [s.frames[f"{leg}_KFE"].position[2] for leg in ("FL", "FR", "HL", "HR")]


@ocp.inequality(unit="m", at="phase_end", when="squat")
def under_the_bar(s):
    """Return the distance of the base below the bar at the end of the squat."""
    return ceiling - s.base.position[2]


@ocp.equality(unit="m/s", at="end")
def at_rest(s):
    """Return the velocities of the base, which are zero at the end."""
    return [s.base.linear_velocity, s.base.angular_velocity]


four = stance("FL FR HL HR")
height = robot.base_height("stand")  # [m]
squat = ocp.Motion(
    ocp.Phase("squat", four, 0.25, ocp.Keyframe(position=(0, 0, 0.17), joints="crouch")),  # [s], [m]
    ocp.Phase("rise", four, 0.25, ocp.Keyframe(position=(0, 0, height), joints="stand")),
)
objective = ocp.Objective(
    ocp.track(base.position, weight=(1, 1, 10)),
    ocp.track(base.orientation, weight=1.0),
    ocp.regularize(joints.velocity, weight=0.01),
    ocp.regularize(joints.torque, weight=0.01),
) + hip_symmetry.weighted(1.0)
limits = ocp.Constraints(
    models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(), knee_clearance, under_the_bar, at_rest
)
problem = ocp.Problem(squat, body.until_end(dt=0.01), objective, limits, initial=body.state(joints="stand"))


def main(bar: float = 0.16) -> float:
    """Solve the squat under a bar at a height [m] and return the height of the base below the bar [m]."""
    solution = solvers.MSiLQR(problem.with_parameters(ceiling=bar)).solve().raise_if_failed()
    print(solution)
    return float(solution.trajectory.phases[0].states[-1, 2])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bar", type=float, default=0.16)
    print(f"{main(**vars(parser.parse_args())):.3f} m")
