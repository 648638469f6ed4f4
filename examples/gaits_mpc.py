"""Mini Cheetah in five gaits with a receding horizon, one objective, and rotors and losses of joints."""

from piaffe import models, ocp, simulation, solvers
from piaffe.models import base, feet, joints

robot = models.load("mini_cheetah", rotors=True, joint_damping=0.01, joint_friction=0.2)  # [Nm s/rad], [Nm]
body = models.WholeBody(robot)
srb = models.SingleRigidBody(robot)


def swing(s):
    """Return 1 for feet in the air, 0 for feet on the ground."""
    return 1 - s.feet.contact


SPEED = 0.5  # [m/s]
COMMAND = {"speed": SPEED, "velocity_gain": 0.02, "lag_gain": 1.0}  # the lag's gain was chosen on seeds 1010 to 1019

# The objective of trot_mpc.py.
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


def with_gait(motion: ocp.Motion) -> ocp.Problem:
    """Return the problem of a gait."""
    return ocp.Problem(motion, cascade, objective + effort, limits, initial=body.state(joints="stand"))


trot = with_gait(models.gaits.trot(**COMMAND))
pace = with_gait(models.gaits.pace(**COMMAND))
bound = with_gait(models.gaits.bound(**COMMAND))
flying_trot = with_gait(models.gaits.flying_trot(**COMMAND))
pronk = with_gait(models.gaits.pronk(**COMMAND))


def main(seconds: float = 5.0) -> float:
    """Run every gait, print its speed from 2 s on, and return the largest relative error."""
    worst = 0.0
    for name in ("trot", "pace", "bound", "flying_trot", "pronk"):
        problem = globals()[name]
        mpc = solvers.RecedingHorizon(problem)
        low = solvers.Vwbc(mpc.plan(problem.initial, 0.0), leave_out=("base.position x", "base.position y"))
        episode = simulation.run_online(mpc, low, simulation.Plant(robot, friction=0.7), seconds=seconds)
        found = episode.tracking(2.0)
        speed = found.velocity[0] if episode.success and found else 0.0
        print(f"{name}: {speed:.3f} m/s of {SPEED:.2f}, {episode.fault or 'upright'}")
        worst = max(worst, abs(speed / SPEED - 1))
    return worst


if __name__ == "__main__":
    print(f"{100 * main():.1f} %")
