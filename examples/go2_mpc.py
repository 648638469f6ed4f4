"""Go2 trots with a receding horizon: on a plant as in the plan, and on one of another author, with other numbers."""

import argparse
import tomllib
from pathlib import Path

from piaffe import models, ocp, simulation, solvers
from piaffe.models import base, feet, joints

HERE = Path(__file__).parent

# What is known of the joints' losses is in the plan; the plant of other_go2.xml has them, and rotors of 0.012 to 0.036.
robot = models.load(
    "go2",
    joint_damping={"hip_joint": 0.15, "thigh_joint": 0.18, "calf_joint": 0.24},  # [Nm s/rad]
    joint_friction={"hip_joint": 0.2, "thigh_joint": 0.4, "calf_joint": 1.0},  # [Nm]
)
body = models.WholeBody(robot)
srb = models.SingleRigidBody(robot)


def swing(s):
    """Return 1 for feet in the air, 0 for feet on the ground."""
    return 1 - s.feet.contact


# As in trot_mpc.py, but torques and forces are twice as large as Mini Cheetah's: their weights are smaller. These were
# chosen by hand on seeds 1000 and 1001 of `piaffe mpc`, on both plants.
trot = models.gaits.trot(speed=0.5, velocity_gain=0.05)  # [m/s], [s]
objective = ocp.Objective(
    ocp.track(base.position, weight=(0, 0, 50)),
    ocp.track(base.orientation, weight=(2, 2, 1)),
    ocp.track(base.linear_velocity, weight=10.0),
    ocp.track(base.angular_velocity, weight=(2, 2, 1)),
    ocp.track(joints.position, weight=1.0),
    ocp.track(joints.velocity, weight=0.01),
    ocp.track(feet.position, weight=10.0, mask=swing),
    ocp.track(feet.velocity, weight=1.0, mask=swing),
    ocp.regularize(joints.torque, weight=0.005),
    ocp.track(base.position, weight=(0, 0, 10), at="phase_end"),
    ocp.track(base.orientation, weight=1.0, at="phase_end"),
    models.soft_landing(weight=1.0),
)
limits = ocp.Constraints(
    models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(), models.joint_speed_limits(),
    models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0),
)  # fmt: skip
effort = ocp.track(feet.force, weight=0.0003)
cascade = body.over(0.25, dt=0.01).without(effort) + srb.over(0.50, dt=0.05).without(limits)
problem = ocp.Problem(trot, cascade, objective + effort, limits, initial=body.state(joints="stand"))


def plants() -> dict[str, simulation.Plant]:
    """Return a plant with the numbers of the plan, and one from a file, whose names are in another one."""
    names = tomllib.loads((HERE / "other_go2.toml").read_text())
    return {
        "own": simulation.Plant(robot),
        "other": simulation.Plant.from_mjcf(HERE / "other_go2.xml", robot, **names),
    }


def main(seconds: float = 5.0) -> float:
    """Run the trot on both plants, and return the speed on that of another author [m/s]."""
    mpc = solvers.RecedingHorizon(problem)
    low = solvers.Vwbc(mpc.plan(problem.initial, 0.0), leave_out=("base.position x", "base.position y"))
    for name, plant in plants().items():
        episode = simulation.run_online(mpc, low, plant, seconds=seconds)
        found = episode.tracking(2.0)
        speed = found.velocity[0] if found else 0.0
        end = episode.fault or ("upright" if episode.upright else "not upright")
        print(f"{name} plant, {plant!r}: {speed:.3f} m/s of 0.50, {end} after {episode.end:.2f} s")
    return speed


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    print(f"{main(**vars(parser.parse_args())):.3f} m/s")
