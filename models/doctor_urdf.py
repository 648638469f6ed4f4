"""Check the text of a URDF before a model is built from it: links, inertias, joints and limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Severity = Literal["error", "warning", "note"]

_PLACEHOLDER = 1000.0  # torques [Nm] and speeds [rad/s] from here on are not those of a robot
_TURNS = 4 * np.pi  # ranges wider than two turns are not those of a leg [rad]


@dataclass(frozen=True)
class Finding:
    """A problem of a robot, or a note about it.

    Args:
        severity: ``"error"``: the robot cannot be used, or its motion would be meaningless; ``"warning"``: it can be
            used, but the part should be checked; ``"note"``: information.
        where: the part, ``"joint 'FL_KFE'"``.
        text: what is wrong - got, expected; what to do.
    """

    severity: Severity
    where: str
    text: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}: {self.text}"


def finding(severity: Severity, where: str, what: str, got: str, expected: str, advice: str) -> Finding:
    """Return a finding whose text follows the template of Piaffe's messages."""
    return Finding(severity, where, f"{what} - got {got}, expected {expected}; {advice}")


def examine_text(urdf: Path) -> tuple[list[Finding], bool]:
    """Return the findings about a URDF file, and whether a model can be built from it."""
    where = f"file '{urdf}'"
    try:
        root = ElementTree.fromstring(urdf.read_bytes())
    except (OSError, ElementTree.ParseError) as error:
        return [finding("error", where, "is not XML", f"'{error}'", "a URDF file", "correct the file")], False
    if root.tag != "robot":
        advice = "convert xacro and SDF to URDF first"
        return [finding("error", where, "is not a URDF", f"<{root.tag}> as outermost tag", "<robot>", advice)], False
    links = {link.get("name", ""): link for link in root.findall("link")}
    joints = [joint for joint in root.findall("joint") if joint.find("parent") is not None]
    found = list(_tree(links, joints))
    for name, link in links.items():
        found += _inertial(f"link '{name}'", link)
    for joint in joints:
        found += _joint(f"joint '{joint.get('name', '')}'", joint)
    unfit = [one for one in found if one.severity == "error" and not one.where.startswith("link")]
    return found, not unfit


def _tree(links: Mapping[str, Element], joints: Sequence[Element]) -> Iterator[Finding]:
    """Yield why links and joints are not one tree."""
    children = [_end(joint, "child") for joint in joints]
    for joint in joints:
        for end in (_end(joint, "parent"), _end(joint, "child")):
            if end not in links:
                where, what = f"joint '{joint.get('name', '')}'", "names a link that does not exist"
                yield finding("error", where, what, f"'{end}'", f"one of {sorted(links)}", "correct the name")
    for name in sorted({name for name in children if children.count(name) > 1}):
        yield finding("error", f"link '{name}'", "closes a loop", "several parents", "one parent", "remove a joint")
    roots = sorted(set(links) - set(children))
    if len(roots) != 1:
        got = f"{roots or 'no'} links without a parent"
        yield finding("error", "robot", "does not have one base link", got, "one", "connect the others to it by joints")


def _inertial(where: str, link: Element) -> Iterator[Finding]:
    """Yield the findings about a link's mass and inertia."""
    inertial = link.find("inertial")
    if inertial is None:
        return
    mass_tag, tensor_tag = inertial.find("mass"), inertial.find("inertia")
    try:
        mass = float(mass_tag.get("value", "nan")) if mass_tag is not None else 0.0
        keys = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")
        entries = [float(tensor_tag.get(key, "0")) if tensor_tag is not None else 0.0 for key in keys]
    except ValueError as error:
        yield finding("error", where, "<inertial> is not numeric", f"'{error}'", "numbers", "correct it")
        return
    if not mass >= 0:
        yield finding("error", where, "mass is impossible", f"{mass:g} kg", "a number ≥ 0", "correct it")
        return
    yield from judge_inertia(where, mass, np.array(entries).reshape(3, 3))


def judge_inertia(where: str, mass: float, tensor: Array) -> Iterator[Finding]:
    """Yield the findings about an inertia about the centre of mass, (3, 3) [kg m^2]."""
    if not np.all(np.isfinite(tensor)):
        yield finding("error", where, "inertia is not finite", "NaN or infinity", "numbers", "correct it")
        return
    smallest, middle, largest = np.linalg.eigvalsh(tensor)
    got = f"principal inertias {smallest:.3g}, {middle:.3g}, {largest:.3g} kg m^2"
    if mass == 0:
        if largest > 0:
            yield finding("warning", where, "has inertia but no mass", f"{got} and 0 kg", "both", "give the mass")
    elif smallest < -1e-9 * abs(largest):
        yield finding("error", where, "inertia is not positive", got, "all > 0", "check the signs")
    elif largest > 0 and smallest <= 1e-9 * largest:
        yield finding("warning", where, "inertia is zero about an axis", got, "all > 0", "add it")
    elif smallest + middle < largest * (1 - 1e-6):
        what, expected = "inertia is impossible for a rigid body", "none larger than the sum of the other two"
        yield finding("warning", where, what, got, expected, "Piaffe uses it unchanged")


def _joint(where: str, joint: Element) -> Iterator[Finding]:
    """Yield the findings about a joint."""
    kind = joint.get("type")
    if kind == "fixed":
        return
    if kind not in ("revolute", "prismatic"):
        continuous = kind == "continuous"
        advice = "make it 'revolute' and give limits" if continuous else "make it 'fixed', or use several single joints"
        expected = "'revolute', 'prismatic' or 'fixed'"
        yield finding("error", where, "its type is not supported", f"'{kind}'", expected, advice)
        return
    if joint.find("mimic") is not None:
        what, advice = "mimics another joint", "Piaffe treats it as an independent joint"
        yield finding("warning", where, what, "<mimic>", "independent joints", advice)
    try:
        axis_tag, limit = joint.find("axis"), joint.find("limit")
        axis = np.array((axis_tag.get("xyz", "1 0 0") if axis_tag is not None else "1 0 0").split(), dtype=float)
        keys = ("lower", "upper", "effort", "velocity")
        limits = {} if limit is None else {key: float(limit.get(key, "0")) for key in keys}
    except ValueError as error:
        yield finding("error", where, "axis or limit is not numeric", f"'{error}'", "numbers", "correct it")
        return
    length = float(np.linalg.norm(axis))
    if abs(length - 1) > 1e-3:
        got = f"{axis.tolist()} of length {length:.4g}"
        severity: Severity = "warning" if length else "error"
        yield finding(severity, where, "axis is not a unit vector", got, "length 1", "scale it")
    if limit is None:
        yield finding("error", where, "has no <limit>", "none", "lower, upper, effort and velocity", "add it")
        return
    yield from _limits(where, **limits)


def _limits(where: str, lower: float, upper: float, effort: float, velocity: float) -> Iterator[Finding]:
    """Yield the findings about a joint's limits."""
    got = f"{lower:g} to {upper:g}"
    if not lower < upper:
        yield finding("warning", where, "range is empty", got, "lower < upper", "Piaffe treats it as unlimited")
    elif upper - lower > _TURNS:
        yield finding("warning", where, "range looks like a placeholder", got, "less than two turns", "correct it")
    for value, what, unit in ((effort, "torque", "Nm"), (velocity, "speed", "rad/s")):
        got = f"{value:g} {unit}"
        if not 0 < value < np.inf:
            expected, advice = "a positive number", "Piaffe treats it as infinite"
            yield finding("warning", where, f"{what} limit is missing", got, expected, advice)
        elif value >= _PLACEHOLDER:
            expected = f"less than {_PLACEHOLDER:g}"
            yield finding("warning", where, f"{what} limit looks like a placeholder", got, expected, "correct it")


def _end(joint: Element, which: str) -> str:
    end = joint.find(which)
    return end.get("link", "") if end is not None else ""
