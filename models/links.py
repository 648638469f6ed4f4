"""Names of the links that a robot's joints move."""

from __future__ import annotations

import pinocchio

from .robot import ROOT, Robot


def body_names(robot: Robot) -> tuple[str, ...]:
    """Return the name of the link that each joint moves, the base's first."""
    names: dict[int, str] = {}
    for frame in robot.model.frames:
        if frame.type == pinocchio.FrameType.BODY and frame.parentJoint not in names:
            names[frame.parentJoint] = frame.name
    return tuple(names.get(j, robot.model.names[j]) for j in range(ROOT, robot.model.njoints))
