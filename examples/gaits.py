"""Mini Cheetah bounds, paces, trots with flight, pronks, trots and walks: three cycles of each gait, solved offline."""

import argparse

from piaffe import models, ocp, solvers
from piaffe.models import base, feet, joints

SPEED, CYCLES = 0.5, 3  # [m/s]

robot = models.load("mini_cheetah")
body = models.WholeBody(robot)


def swing(s):
    """Return 1 for feet in the air, 0 for feet on the ground."""
    return 1 - s.feet.contact


walking = ocp.Objective(
    ocp.track(base.position, weight=(0, 0, 50)),
    ocp.track(base.orientation, weight=(2, 2, 1)),
    ocp.track(base.linear_velocity, weight=2.0),
    ocp.track(base.angular_velocity, weight=(2, 2, 1)),
    ocp.track(joints.position, weight=1.0),
    ocp.track(joints.velocity, weight=0.01),
    ocp.track(feet.position, weight=10.0, mask=swing),
    ocp.track(feet.velocity, weight=0.1, mask=swing),
    ocp.regularize(joints.torque, weight=0.02),
    ocp.track(base.position, weight=(0, 0, 10), at="phase_end"),
    ocp.track(base.orientation, weight=1.0, at="phase_end"),
)
limits = ocp.Constraints(
    models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(), models.joint_speed_limits(),
    models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0),
)  # fmt: skip


def problem_of(gait: ocp.Motion) -> ocp.Problem:
    """Return the problem of three cycles of a gait."""
    return ocp.Problem(
        gait.cycles(CYCLES), body.until_end(dt=0.01), walking, limits, initial=body.state(joints="stand")
    )


bound = problem_of(models.gaits.bound(SPEED))
pace = problem_of(models.gaits.pace(SPEED))
flying_trot = problem_of(models.gaits.flying_trot(SPEED))
pronk = problem_of(models.gaits.pronk(SPEED))
trot = problem_of(models.gaits.trot(SPEED))
walk = problem_of(models.gaits.walk(speed=0.3))
problem = bound


def main(name: str = "bound") -> float:
    """Solve one gait and return the mean speed of the last cycle [m/s]."""
    solution = solvers.MSiLQR(globals()[name]).solve().raise_if_failed()
    print(solution)
    phases = solution.trajectory.phases
    last = phases[-(len(phases) - 1) // CYCLES :]  # the first phase is a stance before the first cycle
    return float((last[-1].states[-1, 0] - last[0].states[0, 0]) / (last[-1].times[-1] - last[0].times[0]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--name", default="bound", choices=["bound", "pace", "flying_trot", "pronk", "trot", "walk"])
    print(f"{main(**vars(parser.parse_args())):.2f} m/s")
