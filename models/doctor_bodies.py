"""Check the bodies of a robot's model: masses, inertias and sizes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio

from .doctor_text import Finding, finding
from .doctor_urdf import judge_inertia
from .kinematics import Kinematics
from .links import body_names
from .robot import ROOT, Robot

_LIGHT, _HEAVY = 0.01, 2000.0  # robots are neither lighter nor heavier [kg]
_SMALL, _LARGE = 0.01, 20.0  # nor smaller or larger [m]
_NO_INERTIA = 1e-14  # [kg m²] or [kg], of all that a joint moves


def examine_bodies(robot: Robot) -> list[Finding]:
    """Return the findings about a robot's bodies; a body is the links that are fixed together."""
    span = _span(robot)
    return [*without_mass(robot.model, robot.base == "free"), *_units(robot, span), *_bodies(robot, span)]


def without_mass(model: pinocchio.Model, floats: bool) -> Iterator[Finding]:
    """Yield bodies without mass: the accelerations of their joints would be infinite."""
    moved = _smallest_inertia(model)
    for j in range(ROOT if floats else ROOT + 1, model.njoints):
        where = f"joint '{model.names[j]}'"
        last = j not in list(model.parents)
        if (last or j == ROOT) and model.inertias[j].mass <= 0:
            got = "0 kg on all links up to the next joint"
            advice = "add <inertial>, or make the joint fixed"
            yield finding("error", where, "moves no mass", got, "a positive mass", advice)
        elif j > ROOT and moved[j] < _NO_INERTIA:
            got, advice = "no inertia about its axis", "add <inertial>, or make the joint fixed"
            yield finding("error", where, "moves no inertia", got, "a positive inertia", advice)


def _smallest_inertia(model: pinocchio.Model) -> dict[int, float]:
    """Return the inertia that each joint moves, per joint of one degree of freedom, at the best of some postures."""
    data, rng = model.createData(), np.random.default_rng(0)
    best = np.zeros(model.nv)
    for _ in range(3):
        q = pinocchio.neutral(model)
        q[7:] = rng.uniform(-1, 1, model.nq - 7)
        best = np.maximum(best, np.diag(pinocchio.crba(model, data, q)))
    return {j: float(best[model.joints[j].idx_v]) for j in range(ROOT + 1, model.njoints)}


def _units(robot: Robot, span: float) -> Iterator[Finding]:
    """Yield a mass or a size that no robot has."""
    if not _LIGHT <= robot.mass <= _HEAVY:
        got, expected = f"{robot.mass:.3g} kg", f"{_LIGHT:g} to {_HEAVY:g} kg"
        yield finding("warning", "robot", "its mass is not that of a robot", got, expected, "check the units: kg")
    if span > 0 and not _SMALL <= span <= _LARGE:
        got, expected = f"{span:.3g} m", f"{_SMALL:g} to {_LARGE:g} m"
        yield finding("warning", "robot", "its size is not that of a robot", got, expected, "check the units: m")
    if 0 < span < robot.foot_radius:
        got, expected = f"{robot.foot_radius:g} m", f"less than the robot's size, {span:.3g} m"
        yield finding("warning", "feet", "the radius is that of no foot", got, expected, "check the units: m")


def _bodies(robot: Robot, span: float) -> Iterator[Finding]:
    """Yield bodies whose inertia is impossible or in a wrong unit."""
    size = f"a part of a robot of {span:.2f} m"
    first = ROOT if robot.base == "free" else ROOT + 1
    for name, inertia in list(zip(body_names(robot), list(robot.model.inertias)[ROOT:], strict=True))[first - ROOT :]:
        if inertia.mass <= 0:
            continue
        where = f"body '{name}'"
        yield from judge_inertia(where, inertia.mass, inertia.inertia)
        gyration = np.sqrt(max(np.trace(inertia.inertia) / 2, 0.0) / inertia.mass)
        if span > 0 and (gyration > span or 0 < gyration < 1e-3 * span):
            got = f"a radius of gyration of {gyration:.3g} m for {inertia.mass:.3g} kg"
            yield finding("warning", where, "inertia does not fit its mass", got, size, "check the unit of the inertia")
        away = float(np.linalg.norm(inertia.lever))
        if away > span > 0:
            got, advice = f"{away:.3g} m from its joint", "check <origin> of <inertial>"
            yield finding("warning", where, "centre of mass is outside the robot", got, size, advice)


def _span(robot: Robot) -> float:
    """Return an upper bound of the size of the robot's parts [m]; 0 for a robot that is a point."""
    places = [robot.model.jointPlacements[j].translation for j in range(ROOT, robot.model.njoints)]
    frames = [frame.placement.translation for frame in robot.model.frames if frame.parentJoint >= ROOT]
    within = float(np.max(np.ptp(np.array(frames), axis=0)))
    return max(float(np.ptp(places, axis=0).max() + max(Kinematics(robot).reach, default=0.0)), within)
