"""Mini Cheetah bounds with two models in one solve: whole body (0.25 s at 10 ms), then rigid body (0.5 s at 50 ms)."""

from piaffe import models, ocp, solvers
from piaffe.models import base, feet, joints

robot = models.load("mini_cheetah")
body = models.WholeBody(robot)
srb = models.SingleRigidBody(robot)


def swing(s):
    """Return 1 for feet in the air, 0 for feet on the ground."""
    return 1 - s.feet.contact


bound = models.gaits.bound(speed=0.5)  # [m/s]
walking = ocp.Objective(
    ocp.track(base.position, weight=(0, 0, 50)),
    ocp.track(base.orientation, weight=(2, 2, 1)),
    ocp.track(base.linear_velocity, weight=2.0),
    ocp.track(base.angular_velocity, weight=(2, 2, 1)),
    ocp.track(joints.position, weight=1.0),
    ocp.track(joints.velocity, weight=0.01),
    ocp.track(feet.position, weight=10.0, mask=swing),
    ocp.regularize(joints.torque, weight=0.02),
    ocp.track(base.position, weight=(0, 0, 10), at="phase_end"),
    ocp.track(base.orientation, weight=1.0, at="phase_end"),
)
limits = ocp.Constraints(
    models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(), models.joint_speed_limits(),
    models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0),
)  # fmt: skip
effort = ocp.track(feet.force, weight=0.01)  # the control of the single rigid body needs a cost
cascade = body.over(0.25, dt=0.01).without(effort) + srb.over(0.50, dt=0.05).without(limits)
problem = ocp.Problem(bound, cascade, walking + effort, limits, initial=body.state(joints="stand"))


def main() -> float:
    """Solve the problem and return the base height at the end of the horizon [m]."""
    solution = solvers.MSiLQR(problem).solve().raise_if_failed()
    print(problem)
    print(solution)
    return float(solution.trajectory.phases[-1].states[-1, 2])


if __name__ == "__main__":
    print(f"{main():.3f} m")
