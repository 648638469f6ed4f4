"""A jump of Go2 and a cart, for files with one mistake each; a file declares what is wrong itself."""

from __future__ import annotations

import casadi as cs
import numpy as np

from piaffe import models, ocp, sampling, solvers
from piaffe.models import base, com, feet, frames, joints, stance

__all__ = [
    "ALL", "BODY", "CHEAP", "HEIGHT", "LIMITS", "NONE", "OBJECTIVE", "ROBOT", "base", "cart", "com", "cs", "drive",
    "feet", "frames", "joints", "jump", "models", "np", "ocp", "pose", "sampling", "solvers", "stance",
]  # fmt: skip

ROBOT = models.load("go2")
BODY = models.WholeBody(ROBOT)
ALL, NONE = stance(roles="all"), stance("")
HEIGHT = ROBOT.base_height("stand")
OBJECTIVE = ocp.Objective(
    ocp.track(base.position, weight=20.0),
    ocp.track(base.orientation, weight=5.0),
    ocp.track(joints.position, weight=1.0),
    ocp.regularize(joints.velocity, weight=0.01),
    ocp.regularize(joints.torque, weight=0.001),
)
LIMITS = ocp.Constraints(models.friction_cone(0.7), models.torque_limits(), models.joint_limits())


def pose(z=HEIGHT, **more):
    """Return the keyframe of a level pose."""
    return ocp.Keyframe(position=(0, 0, z), joints="stand", **more)


def jump(*phases, body=BODY, dt=0.02, objective=OBJECTIVE, limits=LIMITS, initial=None, motion=None, schedule=None):
    """Return a problem of Go2: by default push, flight and landing."""
    hop = (
        ocp.Phase("push", ALL, 0.12, pose()),
        ocp.Phase("flight", NONE, 0.1, pose()),
        ocp.Phase("land", ALL, 0.12, pose()),
    )
    return ocp.Problem(
        motion or ocp.Motion(*(phases or hop)),
        schedule or body.until_end(dt=dt),
        objective,
        limits,
        initial=body.state(joints="stand") if initial is None else initial,
    )


CHEAP = ocp.Objective(ocp.track("x", to=1.0), ocp.regularize("push", weight=0.1))


def _roll(s):
    return {"x": s.v, "v": s.push}


cart = ocp.Model("cart", state={"x": 1, "v": 1}, control={"push": 1}, modes={"roll": _roll})


def drive(*phases, objective=CHEAP, limits=None, initial=(0.0, 0.0), motion=None, schedule=None, dt=0.1, model=cart):
    """Return a problem of a cart that rolls for a second."""
    motion = motion or ocp.Motion(*(phases or (ocp.Phase("go", "roll", 1.0),)))
    return ocp.Problem(motion, schedule or model.until_end(dt=dt), objective, limits, initial=initial)
