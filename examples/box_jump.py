"""Solo12, Go2 and ANYmal C jump onto a box of 15 cm: one motion, with lengths in heights of the standing base."""

# Numbers were chosen on simulations of the policy with seeds from 1000 on, and are judged on seeds 0 to 9:
# piaffe verify jump.npz examples/box_jump.py:anymal_c --simulate --seeds 10 --first-seed 1000

from math import sqrt

import casadi as cs
import numpy as np

from piaffe import models, ocp, solvers
from piaffe.models import base, joints, stance
from piaffe.ocp import rotation

BOX = 0.15  # [m]
DT = 0.01  # [s]
KICKS = {"solo12": (0.65, -0.25, 5.0), "go2": (0.6, -0.25, 5.0), "anymal_c": (0.48, -0.185, 13.0)}
"""Height over that of standing, in heights of the box, and pitch at the end of the kick; weight of the torques."""


@ocp.inequality(unit="N", mask=lambda s: cs.vec(cs.repmat(cs.SX(s.feet.contact).T, 4, 1)))
def grip(s):
    """Keep forces inside the cone: |F_x| + |F_y| ≤ F_z / 2, in axes of the ground below each foot."""
    x, y, z = cs.vertsplit(cs.reshape(cs.SX(s.feet.contact_force), 3, -1))
    return cs.vec(cs.vertcat(0.5 * z + x + y, 0.5 * z + x - y, 0.5 * z - x + y, 0.5 * z - x - y))


def jump(name: str) -> ocp.Problem:
    """Return the jump of a robot: it rears, kicks off with its hind feet, lands on its front feet and pulls up."""
    robot = models.load(name)
    h = robot.base_height("stand")
    raised, pitch, effort = KICKS[name]
    stands = models.WholeBody(robot)
    feet = stands.foot_positions(stands.state(joints="stand"))
    front = np.array(["front" in foot.roles for foot in robot.feet])
    reach = float(feet[:, 0].max())  # from the base to the front feet
    edge = reach + 0.125 * h
    box = models.terrain.Box((edge + 1.0, 0.0), (2.0, 1.5), BOX)
    body = models.WholeBody(robot, terrain=models.terrain.boxes(box))

    def posture(x, z, tilt, fore, hind):
        """Return a keyframe: base at x and z with a pitch, front and hind feet at x and at a height above the floor."""
        places = feet + np.where(front[:, None], (fore[0] - reach, 0, fore[1]), (hind[0] + reach, 0, hind[1]))
        pose = np.array([x, 0, z]), rotation.np_from_rpy(np.array([0, tilt, 0]))
        return ocp.Keyframe(position=pose[0], rpy=(0, tilt, 0), joints=body.kinematics.world_inverse(*pose, places)[0])

    def seconds(t):
        """Return a duration for the robot's size, in whole steps; a swing of a leg takes as long as sqrt(h)."""
        return DT * round(t * sqrt(h / 0.25) / DT)

    start = (reach, 0.0), (-reach, 0.0)
    hind = edge + 0.37 * h
    fore = hind + 1.32 * reach
    on = fore - reach - 0.46 * h, hind + reach - 0.46 * h  # the base when front and hind feet land
    up = h + BOX
    four, rear, head, none = (stance(roles=roles) for roles in ("all", "hind", "front", ()))
    leap = ocp.Motion(
        ocp.Phase("crouch", four, seconds(0.25), posture(-0.1 * h, 0.92 * h, 0.0, *start)),
        ocp.Phase("rear", four, seconds(0.27), posture(0.25 * on[0], 0.95 * h, -0.15, *start)),
        ocp.Phase("kick", rear, seconds(0.18), posture(0.6 * on[0], h + raised * BOX, pitch, (0.5 * (reach + fore) - 0.1 * h, BOX + 0.12 * h), start[1])),
        ocp.Phase("flight", none, seconds(0.10), posture(on[0], 0.9 * h + 0.8 * BOX, -0.2, (fore, BOX), (0.5 * on[0] - reach, 0.3 * h))),
        ocp.Phase("tuck", head, seconds(0.1155), posture(sum(on) / 2, up, -0.1, (fore, BOX), (edge - 0.2 * h, BOX + 0.32 * h))),
        ocp.Phase("place", head, seconds(0.0945), posture(on[1], up, 0.0, (fore, BOX), (hind, BOX))),
        ocp.Phase("settle", four, seconds(0.58), posture((hind + fore) / 2, up, 0.0, (fore, BOX), (hind, BOX))),
    )  # fmt: skip
    slow = (30.0 / robot.joint_speed_limit.min()) ** 2  # weights of speeds, relative to their limit
    objective = ocp.Objective(
        ocp.track(base.position, weight=(9.4, 20, 21.5)),
        ocp.track(base.orientation, weight=(20, 10, 20)),
        ocp.track(base.linear_velocity, weight=1.5),
        ocp.track(base.angular_velocity, weight=1.5),
        ocp.track(joints.position, weight=4 * (10.0, 2.0, 2.0)),
        ocp.track(joints.velocity, weight=0.007 * slow),
        ocp.regularize(joints.torque, weight=effort / robot.torque_limit[0] ** 2),
        ocp.track(base.position, weight=20, at="end"),
        ocp.track(base.orientation, weight=20, at="end"),
        ocp.track(joints.position, weight=5, at="end"),
        ocp.regularize(base.linear_velocity, weight=5, at="end"),
        ocp.regularize(joints.velocity, weight=0.2, at="end"),
    )
    above = ocp.inequality(
        lambda s: s.base.position[2],
        lower=BOX + 0.7 * h,
        unit="m",
        name="belly above box",
        when=("tuck", "place", "settle"),
    )
    limits = ocp.Constraints(
        models.friction_cone(0.6), models.torque_limits(0.86), models.joint_limits(), models.joint_speed_limits(),
        models.foot_clearance(), models.base_height(minimum=0.55 * h), grip, above,
    )  # fmt: skip
    return ocp.Problem(leap, body.until_end(dt=DT), objective, limits, initial=body.state(joints="stand"))


def go2() -> ocp.Problem:
    """Return the jump of Go2."""
    return jump("go2")


def anymal_c() -> ocp.Problem:
    """Return the jump of ANYmal C."""
    return jump("anymal_c")


problem = jump("solo12")


def main(name: str = "solo12") -> float:
    """Solve the jump of a robot; return the height that its base has gained [m]."""
    solution = solvers.MSiLQR(jump(name)).solve().raise_if_failed()
    print(solution)
    first, last = solution.trajectory.phases[0].states[0], solution.trajectory.phases[-1].states[-1]
    return float(last[2] - first[2])


if __name__ == "__main__":
    print(f"{main():.3f} m")
