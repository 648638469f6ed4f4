"""Mini Cheetah bounds on MuJoCo with a receding horizon, and is pushed sideways."""

from piaffe import models, ocp, simulation, solvers
from piaffe.models import base, feet, joints

robot = models.load("mini_cheetah", rotors=True, joint_damping=0.01, joint_friction=0.2)  # [Nm s/rad], [Nm]
body = models.WholeBody(robot)
srb = models.SingleRigidBody(robot)


def swing(s):
    """Return 1 for feet in the air, 0 for feet on the ground."""
    return 1 - s.feet.contact


# The objective of trot_mpc.py.
bound = models.gaits.bound(speed=0.5, velocity_gain=0.02)  # [m/s], [s]
objective = ocp.Objective(
    ocp.track(base.position, weight=(0, 0, 50)),
    ocp.track(base.orientation, weight=(2, 2, 1)),
    ocp.track(base.linear_velocity, weight=10.0),
    ocp.track(base.angular_velocity, weight=(2, 2, 1)),
    ocp.track(joints.position, weight=1.0),
    ocp.track(joints.velocity, weight=0.01),
    ocp.track(feet.position, weight=10.0, mask=swing),
    ocp.track(feet.velocity, weight=1.0, mask=swing),
    ocp.regularize(joints.torque, weight=0.02),
    ocp.track(base.position, weight=(0, 0, 10), at="phase_end"),
    ocp.track(base.orientation, weight=1.0, at="phase_end"),
    models.soft_landing(weight=1.0),
)
limits = ocp.Constraints(
    models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(), models.joint_speed_limits(),
    models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0),
)  # fmt: skip
effort = ocp.track(feet.force, weight=0.008)  # the weights of the rigid body have no torques
cascade = body.over(0.25, dt=0.01).without(effort) + srb.over(0.50, dt=0.05).without(limits)
problem = ocp.Problem(bound, cascade, objective + effort, limits, initial=body.state(joints="stand"))


def run(push: str = "1.5@2.5:y", seconds: float = 5.0) -> simulation.OnlineEpisode:
    """Run the bound with pushes, and return the episode."""
    mpc = solvers.RecedingHorizon(problem)
    low = solvers.Vwbc(mpc.plan(problem.initial, 0.0), leave_out=("base.position x", "base.position y"))
    plant = simulation.Plant(robot, friction=0.7)
    return simulation.run_online(mpc, low, plant, seconds=seconds, pushes=simulation.parse_pushes(push))


def main() -> float:
    """Run the bound, print how it takes the push, and return its speed in the last second [m/s]."""
    episode = run()
    for what, first, last in (
        ("before the push", 1.5, 2.5),
        ("in the second after it", 2.5, 3.5),
        ("at the end", 4.0, 5.0),
    ):
        found = episode.tracking(first, last)
        print(f"{what}: {found.velocity[0]:.3f} m/s ahead, {found.velocity[1]:+.3f} m/s to the left")
    return float(episode.tracking(4.0, 5.0).velocity[0])


if __name__ == "__main__":
    print(f"{main():.3f} m/s")
