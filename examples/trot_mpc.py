"""Mini Cheetah trots on MuJoCo: plans 50 times a second, torques 500 times a second; it speeds up, and turns."""

from piaffe import models, ocp, simulation, solvers
from piaffe.models import base, feet, joints

robot = models.load("mini_cheetah")
body = models.WholeBody(robot)
srb = models.SingleRigidBody(robot)


def swing(s):
    """Return 1 for feet in the air, 0 for feet on the ground."""
    return 1 - s.feet.contact


# The weights were chosen by hand for five gaits at 0.5 m/s, with rotors and losses of joints, on seeds 1000 to 1013 of
# start, mass and friction.
trot = models.gaits.trot(speed=0.5, velocity_gain=0.02)  # [m/s], [s]
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
problem = ocp.Problem(trot, cascade, objective + effort, limits, initial=body.state(joints="stand"))


def run(seconds: float = 8.0) -> simulation.OnlineEpisode:
    """Run the trot with two commands, and return the episode."""
    mpc = solvers.RecedingHorizon(problem)
    low = solvers.Vwbc(mpc.plan(problem.initial, 0.0), leave_out=("base.position x", "base.position y"))
    commands = simulation.parse_commands("vx=0.8@3 yaw=0.5@5")  # [m/s] at 3 s, [rad/s] at 5 s
    return simulation.run_online(mpc, low, simulation.Plant(robot, friction=0.7), seconds=seconds, commands=commands)


def main() -> float:
    """Run the trot, print how it follows its commands, and return the speed before the first of them [m/s]."""
    episode = run()
    for first, last in ((2.0, 3.0), (4.0, 5.0), (6.0, 8.0)):
        found = episode.tracking(first, last)
        print(
            f"{first:.0f} to {last:.0f} s: {found.velocity[0]:.3f} m/s of {found.commanded[0]:.2f}, "
            f"yaw {found.yaw_rate:+.3f} rad/s of {found.commanded_yaw_rate:+.2f}"
        )
    return float(episode.tracking(2.0, 3.0).velocity[0])


if __name__ == "__main__":
    print(f"{main():.3f} m/s")
