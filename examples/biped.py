"""A biped with two point feet hops forward; with four contact points per foot, the error names the redundant ones."""

from pathlib import Path

from piaffe import models, ocp, solvers
from piaffe.errors import ModelError
from piaffe.models import base, joints, stance

URDF = Path(__file__).with_name("biped.urdf")
STEP = 0.10  # [m]

robot = models.load(URDF, feet={"L": "L_FOOT", "R": "R_FOOT"}, foot_radius=0.02)  # [m]
body = models.WholeBody(robot)

both, height = stance("L R"), robot.base_height("stand")  # [m]
hop = ocp.Motion(
    ocp.Phase("push", both, 0.20, ocp.Keyframe(position=(0.00, 0, height), joints="stand")),  # [s], [m]
    ocp.Phase("flight", stance(""), 0.20, ocp.Keyframe(position=(STEP, 0, height), joints="stand")),
    ocp.Phase("land", both, 0.20, ocp.Keyframe(position=(STEP, 0, height), joints="stand")),
)  # fmt: skip
objective = ocp.Objective(
    ocp.track(base.position, weight=(10, 10, 10)),
    ocp.track(base.orientation, weight=5.0),
    ocp.track(base.angular_velocity, weight=0.1),
    ocp.track(joints.position, weight=1.0),
    ocp.track(joints.velocity, weight=0.01),
    ocp.regularize(joints.torque, weight=0.01),
    ocp.track(base.position, weight=100.0, at="end"),
    ocp.regularize(base.linear_velocity, weight=10.0, at="end"),
)
limits = ocp.Constraints(
    models.friction_cone(mu=0.7), models.torque_limits(), models.joint_limits(), models.joint_speed_limits(),
    models.foot_clearance(),
    ocp.equality(lambda s: s.feet.position["x"] - STEP, name="landing spot", unit="m", at="phase_end", when="flight"),
)  # fmt: skip
problem = ocp.Problem(hop, body.until_end(dt=0.01), objective, limits, initial=body.state(joints="stand"))


def soles() -> str:
    """Return the error for a robot with contact points at the corners of its soles, which are redundant."""
    corners = [f"{side}_{end}_{edge}" for side in "LR" for end in ("TOE", "HEEL") for edge in ("IN", "OUT")]
    try:
        models.WholeBody(models.load(URDF, feet=corners))
    except ModelError as error:
        return str(error)
    return "the corners are independent"


def main() -> float:
    """Solve the hop and return the distance that the feet moved [m]."""
    print(soles())
    solution = solvers.MSiLQR(problem).solve().raise_if_failed()
    print(solution)
    first, last = (solution.trajectory.phases[i].states[i] for i in (0, -1))
    return float((body.foot_positions(last) - body.foot_positions(first))[:, 0].mean())


if __name__ == "__main__":
    print(f"{main():.3f} m")
