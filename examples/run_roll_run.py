"""Mini Cheetah paces, rolls over sideways and paces again: ``+`` joins saved solutions, one solve refines them."""

from math import pi
from pathlib import Path
from tempfile import mkdtemp

from piaffe import models, ocp, solvers
from piaffe.models import base, joints, stance

SPEED = 0.5  # [m/s]

robot = models.load("mini_cheetah")
body = models.WholeBody(robot)

limits = ocp.Constraints(
    models.friction_cone(mu=0.6), models.torque_limits(0.9), models.joint_limits(), models.joint_speed_limits(),
    models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0),
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
four, right, none = stance("FL FR HL HR"), stance("FR HR"), stance("")
roll = ocp.Motion(
    ocp.Phase("push", four, 0.12, ocp.Keyframe(position=(0, -0.15, 0.26), rpy=(pi / 6, 0, 0), joints="crouch")),
    ocp.Phase("lean", right, 0.21, ocp.Keyframe(position=(0, -0.25, 0.33), rpy=(pi / 2, 0, 0), joints="lean")),
    ocp.Phase("flight", none, 0.42, ocp.Keyframe(position=(0, -0.55, 0.22), rpy=(2 * pi, 0, 0), joints="tuck")),
    ocp.Phase("land", four, 0.15, ocp.Keyframe(position=(0, -0.55, 0.25), rpy=(2 * pi, 0, 0), joints="tuck")),
    ocp.Phase("hop", none, 0.20, ocp.Keyframe(position=(0, -0.55, 0.25), rpy=(2 * pi, 0, 0), joints="stand")),
    ocp.Phase("settle", four, 0.15, ocp.Keyframe(position=(0, -0.55, 0.25), rpy=(2 * pi, 0, 0), joints="stand")),
)
pace = models.gaits.pace(speed=SPEED).cycles(1)


def saved(motion: ocp.Motion, path: Path) -> ocp.Motion:
    """Return the saved solution of a motion as a motion; if there is no file, solve the motion from standing first."""
    if not path.exists():
        problem = ocp.Problem(motion, body.until_end(dt=0.01), objective, limits, initial=body.state(joints="stand"))
        solvers.MSiLQR(problem).solve().raise_if_failed().save(path)
    return ocp.Motion.from_solution(solvers.Solution.load(path))


def problem(folder: Path | None = None) -> ocp.Problem:
    """Return the problem of the joined motion: each piece begins at the position, yaw and turns of the piece before."""
    folder = folder or Path(mkdtemp())
    paced, rolled = saved(pace, folder / "pace.npz"), saved(roll, folder / "roll.npz")
    whole = paced + rolled + paced
    return ocp.Problem(whole, body.until_end(dt=0.01), objective, limits, initial=body.state(joints="stand"))


def main(folder: Path | None = None) -> float:
    """Solve the joined motion and return the forward distance [m]."""
    solution = solvers.MSiLQR(problem(folder)).solve().raise_if_failed()
    print(solution)
    return float(solution.trajectory.phases[-1].states[-1, 0])


if __name__ == "__main__":
    print(f"{main():.2f} m")
