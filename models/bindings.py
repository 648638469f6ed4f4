"""Bind the quantities of a whole robot as expressions of its state, for every model that has all its joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any

import casadi as cs
import numpy as np

from piaffe.ocp import Bound, Quantity, rotation

from .ground import Ground
from .postures import HEIGHT, XYZ, foot_labels, reach_labels
from .quantities import base, com, feet, frames, joints, momentum
from .recursions import Recursion
from .robot import Robot
from .tree import Inertials, Point

_TINY = 1e-12  # avoids 0/0 where the base's x axis is vertical, so that it has no heading


class Makers(dict[str, Callable[[], Bound]]):
    """Functions that make the quantities, by path; each is called when a term uses its quantity."""

    def supply(
        self, quantity: Quantity, labels: tuple[str, ...], value: Callable[[], cs.SX], mask: cs.SX | None = None
    ) -> None:
        """Add a quantity: the function that makes its value, the labels of its components and its mask."""
        self[quantity.path] = lambda: Bound(quantity, value(), labels, mask)


def bind_motion(
    robot: Robot, points: Mapping[str, Point], motion: Recursion, x: cs.SX, p: Mapping[str, cs.SX], ground: Ground
) -> Makers:
    """Return the quantities that depend on positions and velocities alone.

    Args:
        robot: the robot.
        points: a point for each of its frames, see :func:`frame_points`.
        motion: the recursion over its tree at the state x.
        x: the state, (nx, 1).
        p: ``contact``, ``landing``, ``lifting``, ``foot_radius``, ``link_mass``, ``link_com`` and ``link_inertia``, as
            in the slots of the whole body; without the last three, there is no centre of mass and no momentum.
        ground: the ground.
    """
    each, names, contacts = foot_labels(robot), robot.joint_names, foot_points(robot, points)
    nq, make = motion.tree.nq, Makers()

    def places() -> list[cs.SX]:
        return [motion.point(point) for point in contacts]

    @cache
    def heights() -> cs.SX:
        return stacked(ground.gaps(places(), p["foot_radius"]))

    def clearances() -> cs.SX:  # with the same expressions as the heights, which share their code
        more = ground.other_clearances(places(), p["foot_radius"])
        return cs.vertcat(heights(), *more) if more else heights()

    def speeds() -> cs.SX:
        upward = ground.normals(len(contacts))
        velocities = [motion.velocity(point) for point in contacts]
        return stacked([cs.dot(normal, velocity) for normal, velocity in zip(upward, velocities, strict=True)])

    def reach() -> cs.SX:
        heading = rotation.matrix(x[3:7])[:2, 0]
        heading /= cs.sqrt(cs.sumsqr(heading) + _TINY)
        to_heading = cs.vertcat(cs.horzcat(heading[0], heading[1]), cs.horzcat(-heading[1], heading[0]))
        return cs.vertcat(*(to_heading @ (place[:2] - x[:2]) for place in places()))

    if not motion.tree.fixed:
        make.supply(base.position, XYZ, lambda: motion.position)
        make.supply(base.orientation, XYZ, lambda: x[3:7])
        make.supply(base.linear_velocity, XYZ, lambda: motion.v[:3])
        make.supply(base.angular_velocity, XYZ, lambda: motion.v[3:6])
        make.supply(base.height, HEIGHT, lambda: x[2] - ground.mean_height(places()))
        make.supply(base.ground_normal, XYZ, lambda: ground_normal(x[3:7], ground.slope(places())))
        make.supply(feet.reach, reach_labels(robot), reach)
    make.supply(joints.position, names, lambda: x[nq - len(names) : nq])
    make.supply(joints.velocity, names, lambda: motion.v[6:])
    make.supply(feet.position, each, lambda: stacked(places()))
    make.supply(feet.velocity, each, lambda: stacked([motion.velocity(point) for point in contacts]))
    make.supply(feet.height, robot.foot_names, heights)
    make.supply(feet.clearance, clearance_labels(robot, ground), clearances)
    make.supply(feet.normal_speed, robot.foot_names, speeds)
    make.supply(feet.normal, each, lambda: stacked(ground.normals(len(contacts))))
    make.supply(feet.contact, robot.foot_names, lambda: p["contact"])
    make.supply(feet.landing, robot.foot_names, lambda: p["landing"])
    make.supply(feet.lifting, robot.foot_names, lambda: p["lifting"])
    if "link_mass" in p:
        body = inertials(p)
        make.supply(com.position, XYZ, lambda: motion.centre_of_mass(body))
        make.supply(com.velocity, XYZ, lambda: motion.momentum(body)[0] / cs.sum1(p["link_mass"]))
        make.supply(momentum, XYZ, lambda: motion.momentum(body)[1])
    for name, point in points.items():
        make.supply(frames[name].position, XYZ, partial(motion.point, point))
        make.supply(frames[name].velocity, XYZ, partial(motion.velocity, point))
    return make


def absent_quantities(robot: Robot) -> dict[str, str]:
    """Return the quantities that a robot does not have, by path, and why."""
    if robot.base == "free":
        return {}
    of_base = (base.position, base.orientation, base.linear_velocity, base.angular_velocity, base.height)
    return dict.fromkeys(
        (quantity.path for quantity in (*of_base, base.ground_normal, feet.reach)),
        f"the base of '{robot.name}' is fixed; use frames or joints",
    )


def clearance_labels(robot: Robot, ground: Ground) -> tuple[str, ...]:
    """Return the names of the entries of ``feet.clearance``: a foot's name, and what it keeps away from."""
    return tuple(name if not what else f"{name} {what}" for what in ground.kept for name in robot.foot_names)


def in_contact_axes(ground: Ground, vectors: cs.SX) -> cs.SX:
    """Return stacked vectors of all feet, (3 nf, 1), in the axes of their contacts."""
    return stacked(ground.in_contact_axes(cs.vertsplit(vectors, 3) if vectors.numel() else []))


def stacked(parts: list[cs.SX]) -> cs.SX:
    """Return parts below each other, (0, 1) if there are none."""
    return cs.vertcat(*parts) if parts else cs.SX(0, 1)


def ground_normal(orientation: cs.SX, slope: tuple[Any, Any]) -> cs.SX:
    """Return the upward unit normal of the ground in the axes of a body, (3, 1).

    Args:
        orientation: quaternion of the body, w first, (4, 1).
        slope: derivatives of the ground's height by x and y.
    """
    upward = cs.vertcat(-slope[0], -slope[1], 1.0)
    in_body: cs.SX = rotation.matrix(orientation).T @ cs.SX(upward / cs.norm_2(upward))
    return in_body


def inertials(p: Mapping[str, cs.SX]) -> Inertials:
    """Return the inertial parameters of the links, from the slots ``link_mass``, ``link_com`` and ``link_inertia``."""
    return Inertials.of(p["link_mass"], p["link_com"], p["link_inertia"])


def frame_points(robot: Robot) -> dict[str, Point]:
    """Return the origin of every frame by name; a joint and a link of the same name have the same origin."""
    points: dict[str, Point] = {}
    for frame in robot.model.frames:
        if frame.parentJoint > 0:
            points.setdefault(frame.name, Point(int(frame.parentJoint) - 1, np.array(frame.placement.translation)))
    return points


def foot_points(robot: Robot, points: Mapping[str, Point]) -> tuple[Point, ...]:
    """Return the points of the feet, in the robot's order of feet."""
    return tuple(points[foot.frame] for foot in robot.feet)
