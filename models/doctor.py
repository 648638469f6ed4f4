"""Diagnose a robot: its URDF, its bodies, its feet, and whether it can stand on them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pinocchio
from numpy.typing import NDArray

from piaffe.errors import ModelError

from .doctor_bodies import examine_bodies, without_mass
from .doctor_feet import examine_feet
from .doctor_text import Finding, finding
from .doctor_urdf import examine_text, merge_findings
from .kinematics import Kinematics
from .robot import ROOT, Foot, Robot
from .robots import build_model, crossed_feet, leaf_frames, load, locate, names, unclear_base

Array = NDArray[np.float64]
Feet = Sequence[str] | Sequence[Foot] | Mapping[str, str] | None

_ORDER = {"error": 0, "warning": 1, "note": 2}


def diagnose(
    name_or_urdf_path: str | Path,
    *,
    feet: Feet = None,
    foot_radius: float | None = None,
    base: str | None = None,
    locked: Mapping[str, float] | None = None,
) -> list[Finding]:
    """Return the findings about a robot, the most severe first; a correct robot has notes at most.

    :func:`piaffe.models.load` raises what is an error here, and keeps the warnings in ``robot.warnings``.

    Args:
        name_or_urdf_path: as for :func:`piaffe.models.load`.
        feet: as for :func:`piaffe.models.load`; without them only the URDF and its masses are examined.
        foot_radius: radius of the foot's ball [m].
        base: as for :func:`piaffe.models.load`.
        locked: as for :func:`piaffe.models.load`.
    """
    urdf = locate(name_or_urdf_path)[0]
    found, buildable = examine_text(urdf, locked or ())
    if buildable:
        found += _examine_model(name_or_urdf_path, urdf, feet, foot_radius, base, locked)
    return sorted(merge_findings(found), key=lambda one: _ORDER[one.severity])


def _examine_model(
    name: str | Path,
    urdf: Path,
    feet: Feet,
    foot_radius: float | None,
    base: str | None,
    locked: Mapping[str, float] | None,
) -> list[Finding]:
    try:
        model = build_model(urdf, locked)
    except ModelError as error:
        return [Finding("error", f"file '{urdf}'", f"Pinocchio cannot read it - {error}")]
    if model.njoints <= ROOT + 1:
        advice = "check the types of the joints"
        return [finding("error", "robot", "has no joints", "none that moves", "at least one", advice)]
    known = str(name) in names()
    found = [_summary(model), *([] if known else _equal(model))]
    if not known and base is None:
        found += unclear_base(urdf, model)
    floats = base != "fixed"
    if any(one.severity == "error" for one in found):
        return found
    if feet is None and not known and floats:
        advice = f"choose their frames, for example among {leaf_frames(model)}"
        got = "none"
        return [
            *found,
            *without_mass(model, floats),
            finding("note", "feet", "are not given", got, "at least one", advice),
        ]
    try:
        robot = load(name, feet=feet, foot_radius=foot_radius, base=base, locked=locked, checked=False)
    except ModelError as error:
        return [*found, Finding("error", "feet", str(error))]
    if known and not np.array_equal(robot.torque_limit, model.upperEffortLimit[6:]):
        text = f"the URDF of {robot.name} lacks some; Piaffe has them from other sources"
        found.append(Finding("note", "limits", text))
    found += examine_bodies(robot)
    if robot.base == "free":
        found += [*crossed_feet(robot.feet), *examine_feet(robot), *_stand(robot)]
    if not known:
        found.append(_entry(robot, urdf, base, locked))
    return [*found, *_looks(robot)]


def _equal(model: pinocchio.Model) -> Iterator[Finding]:
    """Yield the known robots that have the same joints, in the same places, with the same masses."""
    for name in names():
        try:
            other = build_model(locate(name)[0])
        except ModelError:  # its package is not installed
            continue
        if _same(model, other):
            text = f"equals '{name}': models.load('{name}') has its feet, poses and limits"
            yield Finding("note", "robot", text)


def _same(a: pinocchio.Model, b: pinocchio.Model) -> bool:
    if a.njoints != b.njoints or list(a.parents) != list(b.parents):
        return False
    placed = zip(a.jointPlacements, b.jointPlacements, strict=True)
    masses = zip(a.inertias, b.inertias, strict=True)
    return all(one.isApprox(other, 1e-6) for one, other in placed) and all(
        one.isApprox(other, 1e-6) for one, other in masses
    )


def _entry(robot: Robot, urdf: Path, base: str | None, locked: Mapping[str, float] | None) -> Finding:
    """Return the call that loads the robot, to paste."""
    feet = {foot.name: foot.frame for foot in robot.feet}
    given = [f'"{urdf}"', *([f"feet={feet}", f"foot_radius={robot.foot_radius:g}"] if feet else [])]
    if base is not None:
        given.append(f"base={base!r}")
    if locked:
        given.append(f"locked={dict(locked)}")
    return Finding("note", "loader", f"models.load({', '.join(given)})")


def _summary(model: pinocchio.Model) -> Finding:
    mass = pinocchio.computeTotalMass(model)
    return Finding("note", "robot", f"{model.name}: {model.njoints - ROOT - 1} joints, {mass:.3f} kg")


def _stand(robot: Robot) -> Iterator[Finding]:
    """Yield what prevents the robot from standing at rest in its ``"stand"`` pose."""
    pose, advice = robot.pose("stand"), "give another pose 'stand'"
    for name, angle, lower, upper in zip(robot.joint_names, pose, robot.joint_lower, robot.joint_upper, strict=True):
        if not lower <= angle <= upper:
            got, expected = f"{angle:.3f} rad", f"{lower:g} to {upper:g}"
            yield finding("warning", f"joint '{name}'", "exceeds its limits in pose 'stand'", got, expected, advice)
    feet = Kinematics(robot).feet(pose)
    if np.ptp(feet[:, 2]) > 0.02 + 0.05 * np.ptp(feet[:, :2], axis=0).max():
        heights = dict(zip(robot.foot_names, feet[:, 2].round(3).tolist(), strict=True))
        yield finding("warning", "pose 'stand'", "feet are not level", f"heights {heights} m", "one plane", advice)
    if len(robot.feet) >= 3:
        yield from _rest(robot, pose)


def _rest(robot: Robot, pose: Array) -> Iterator[Finding]:
    """Yield feet without load and joints with too little torque, when the feet share the weight at rest."""
    q = pinocchio.neutral(robot.model)
    q[7:] = pose
    data = robot.model.createData()
    effort = pinocchio.computeGeneralizedGravity(robot.model, data, q)
    pinocchio.computeJointJacobians(robot.model, data, q)
    pinocchio.updateFramePlacements(robot.model, data)
    world = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    rise = np.array(
        [pinocchio.getFrameJacobian(robot.model, data, robot.frame_id(f.frame), world)[2] for f in robot.feet]
    )
    force = np.linalg.lstsq(rise[:, :6].T, effort[:6], rcond=None)[0]
    for foot, newton in zip(robot.feet, force, strict=True):
        if newton < 0:
            what, got = "carries no weight in pose 'stand'", f"{newton:.1f} N"
            advice = "the centre of mass is not above the feet: change the pose"
            yield finding("warning", f"foot '{foot.name}'", what, got, "a force > 0", advice)
    torque = effort[6:] - rise[:, 6:].T @ force
    for name, needed, limit in zip(robot.joint_names, torque, robot.torque_limit, strict=True):
        if abs(needed) > limit:
            got, expected = f"a limit of {limit:g} Nm", f"at least {abs(needed):.2f} Nm"
            what = "has too little torque to stand"
            yield finding("warning", f"joint '{name}'", what, got, expected, "check the limit")


def _looks(robot: Robot) -> Iterator[Finding]:
    """Yield missing shapes."""
    if robot.visual is None:
        got, expected = f"no file for some mesh below {list(robot.package_dirs)}", "all of them"
        yield finding("note", "visual geometry", "cannot be read", got, expected, "capsules are drawn instead")
