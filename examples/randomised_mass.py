"""Mini Cheetah trots with a hundred random payloads, friction coefficients and initial states, solved as one batch."""

import numpy as np

from piaffe import models, ocp, solvers
from piaffe.models import base, feet, joints

robot = models.load("mini_cheetah")
body = models.WholeBody(robot)


def swing(s):
    """Return 1 for feet in the air, 0 for feet on the ground."""
    return 1 - s.feet.contact


walking = ocp.Objective(
    ocp.track(base.position, weight=(0, 0, 50)),
    ocp.track(base.orientation, weight=2.0),
    ocp.track(base.linear_velocity, weight=2.0),
    ocp.track(base.angular_velocity, weight=2.0),
    ocp.track(joints.position, weight=1.0),
    ocp.track(joints.velocity, weight=0.01),
    ocp.track(feet.position, weight=10.0, mask=swing),
    ocp.regularize(joints.torque, weight=0.02),
)
limits = ocp.Constraints(models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits())
problem = ocp.Problem(
    models.gaits.trot(speed=0.5), body.over(0.4, dt=0.01), walking, limits, initial=body.state(joints="stand")
)


def main(count: int = 100, seed: int = 0) -> float:
    """Solve every instance; return the largest torque with the heaviest payload, divided by the nominal one."""
    compiled = ocp.compile_problem(problem)
    nominal = solvers.MSiLQR(compiled).solve().raise_if_failed()

    random = np.random.default_rng(seed)
    masses = np.tile(compiled.parameters["mini_cheetah.link_mass"], (count, 1))
    masses[:, 0] += random.uniform(0.0, 3.0, count)  # a payload on the trunk [kg]
    starts = np.tile(problem.initial, (count, 1))
    starts[:, 2] += random.uniform(-0.005, 0.02, count)  # base above or below its nominal height [m]
    starts[:, 19:22] += random.normal(0.0, 0.05, (count, 3))  # disturbed velocity [m/s]
    batch = solvers.solve_batch(
        compiled,
        starts,
        {"mini_cheetah.link_mass": masses, "friction cone.mu": random.uniform(0.4, 0.9, count)},
        warm_start=nominal,
    )
    print(batch)
    torque = np.abs(batch.controls).max(axis=(1, 2))
    payload = masses[:, 0] - masses[:, 0].min()
    print(
        f"torque per payload {np.polyfit(payload, torque, 1)[0]:.2f} Nm/kg; "
        f"mean iterations {batch.iterations.mean():.0f}"
    )
    return float(torque[np.argmax(payload)] / np.abs(nominal.controls).max())


if __name__ == "__main__":
    print(f"{main():.2f} of the nominal torque")
