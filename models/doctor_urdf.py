"""Check the text of a URDF before a model is built from it: links, inertias, joints and limits."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from .doctor_text import (
    Finding,
    Severity,
    examine_names,
    examine_origin,
    examine_parts,
    finding,
    number,
    numbers,
)

Array = NDArray[np.float64]

_PLACEHOLDER = 1000.0  # torques [Nm] and speeds [rad/s] from here on are not those of a robot
_TURNS = 4 * np.pi  # ranges wider than two turns are not those of a leg [rad]
_ROUNDING = 1e-20  # [kg m^2]
_LONG = 10.0  # ranges wider than this are not those of a slide [m]

JOINT_TYPES = ("revolute", "continuous", "prismatic")
"""The types of joints that move; the model, MuJoCo's scene and the doctor know these."""


def merge_findings(found: list[Finding]) -> list[Finding]:
    """Merge findings of equal text into one; drop findings about a body that are also about its link."""
    places: dict[tuple[Severity, str, str], list[str]] = {}
    for one in found:
        kind, _, name = one.where.partition(" ")
        if kind == "body" and replace(one, where=f"link {name}") in found:
            continue
        same = places.setdefault((one.severity, kind, one.text), [])
        if name not in same:
            same.append(name)
    return [
        Finding(severity, f"{kind} {', '.join(same)}".strip(), text) for (severity, kind, text), same in places.items()
    ]


def examine_text(urdf: Path, locked: Collection[str] = ()) -> tuple[list[Finding], bool]:
    """Return the findings about a URDF file, and whether a model can be built from it.

    Args:
        urdf: the file.
        locked: names of joints that are locked: they may mimic another joint.
    """
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
    found = [*examine_names(root), *_tree(links, joints)]
    for name, link in links.items():
        found += [*examine_parts(f"link '{name}'", link), *_inertial(f"link '{name}'", link)]
    for joint in joints:
        found += examine_parts(f"joint '{joint.get('name', '')}'", joint)
        found += _joint(f"joint '{joint.get('name', '')}'", joint, joint.get("name", "") in locked)
    unfit = [one for one in found if one.severity == "error" and not one.where.startswith("link")]
    return found, not unfit


def root_link(urdf: Path) -> str:
    """Return the name of the link that has no parent, of a file without errors."""
    root = ElementTree.fromstring(urdf.read_bytes())
    children = {_end(joint, "child") for joint in root.findall("joint")}
    return next(link.get("name", "") for link in root.findall("link") if link.get("name", "") not in children)


def _tree(links: Mapping[str, Element], joints: Sequence[Element]) -> Iterator[Finding]:
    """Yield why links and joints are not one tree."""
    children = [_end(joint, "child") for joint in joints]
    for joint in joints:
        for end in (_end(joint, "parent"), _end(joint, "child")):
            if end not in links:
                where, what = f"joint '{joint.get('name', '')}'", "names a link that does not exist"
                yield finding("error", where, what, f"'{end}'", f"one of {sorted(links)}", "correct the name")
    looped = sorted({name for name in children if children.count(name) > 1})
    for name in looped:
        parents = [joint.get("name", "") for joint in joints if _end(joint, "child") == name]
        where, advice = f"joint {', '.join(map(repr, parents))}", f"remove one of the joints to '{name}'"
        got = f"{len(parents)} joints to link '{name}'"
        yield finding("error", where, "closes a loop", got, "one joint to each link", advice)
    roots = sorted(set(links) - set(children))
    if len(roots) != 1:
        got = f"{roots or 'no'} links without a parent"
        yield finding("error", "robot", "does not have one base link", got, "one", "connect the others to it by joints")
        return
    reached, ahead = set(roots), list(roots)
    while ahead and not looped:
        at = ahead.pop()
        following = {_end(joint, "child") for joint in joints if _end(joint, "parent") == at} - reached
        reached |= following
        ahead += following
    if not looped and set(links) - reached:
        where, got = f"link {', '.join(map(repr, sorted(set(links) - reached)))}", f"no path from '{roots[0]}'"
        yield finding("error", where, "is not connected to the base", got, "a tree", "correct the joints' parents")


def _inertial(where: str, link: Element) -> Iterator[Finding]:
    """Yield the findings about a link's mass and inertia."""
    inertial = link.find("inertial")
    if inertial is None:
        return
    mass_tag, tensor_tag = inertial.find("mass"), inertial.find("inertia")
    keys = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")
    if mass_tag is None or tensor_tag is None or "value" not in mass_tag.attrib or set(keys) - set(tensor_tag.attrib):
        lacking = [] if tensor_tag is None else sorted(set(keys) - set(tensor_tag.attrib))
        got = f"<inertia> without {', '.join(lacking)}" if lacking else "no <mass value=...> or no <inertia>"
        expected = "a mass and six numbers of the inertia"
        yield finding("error", where, "<inertial> is not complete", got, expected, "add what is missing")
        return
    try:
        turned = list(examine_origin(where, inertial))
        mass = number(mass_tag.get("value", ""))
        entries = [number(tensor_tag.get(key, "")) for key in keys]
    except ValueError as error:
        yield finding("error", where, "<inertial> is not numeric", f"'{error}'", "numbers", "correct it")
        return
    if not 0 <= mass < np.inf:
        yield finding("error", where, "mass is impossible", f"{mass:g} kg", "a number ≥ 0", "correct it")
        return
    yield from turned
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
    elif smallest < -max(1e-9 * abs(largest), _ROUNDING):
        yield finding("error", where, "inertia is not positive", got, "all > 0", "check the signs")
    elif largest > 0 and smallest <= 1e-9 * largest:
        yield finding("warning", where, "inertia is zero about an axis", got, "all > 0", "add it")
    elif smallest + middle < largest * (1 - 1e-6):
        what, expected = "inertia is impossible for a rigid body", "none larger than the sum of the other two"
        yield finding("warning", where, what, got, expected, "Piaffe uses it unchanged")


def _joint(where: str, joint: Element, locked: bool) -> Iterator[Finding]:
    """Yield the findings about a joint."""
    kind = joint.get("type")
    if kind not in (*JOINT_TYPES, "fixed"):
        expected = ", ".join(f"'{known}'" for known in JOINT_TYPES) + " or 'fixed'"
        advice = "make it 'fixed', or use several single joints"
        if kind == "floating":
            advice = "remove it and the link before it: Piaffe adds the floating base itself, models.load(base='free')"
        yield finding("error", where, "its type is not supported", f"'{kind}'", expected, advice)
        return
    try:
        turned = list(examine_origin(where, joint))
        axis_tag, limit = joint.find("axis"), joint.find("limit")
        axis = numbers(axis_tag.get("xyz", "1 0 0") if axis_tag is not None else "1 0 0")
        keys = ("lower", "upper", "effort", "velocity")
        limits = {} if limit is None else {key: number(limit.get(key, "0")) for key in keys}
    except ValueError as error:
        what = "origin, axis or limit is not numeric"
        yield finding("error", where, what, f"'{error}'", "numbers with a decimal point", "correct it")
        return
    yield from turned
    if kind == "fixed":
        return
    mimic = joint.find("mimic")
    if mimic is not None and not locked:
        got, advice = f"<mimic joint='{mimic.get('joint', '')}'>", f"lock it, {_lock(joint)}, or remove <mimic>"
        yield finding("error", where, "mimics another joint", got, "independent joints", advice)
    if axis.shape != (3,) or not np.all(np.isfinite(axis)):
        yield finding("error", where, "axis is not a direction", f"{axis.tolist()}", "three numbers", "correct it")
        return
    length = float(np.linalg.norm(axis))
    if abs(length - 1) > 1e-3:
        got = f"{axis.tolist()} of length {length:.4g}"
        severity: Severity = "warning" if length else "error"
        yield finding(severity, where, "axis is not a unit vector", got, "length 1", "scale it")
    if limit is None and kind == "continuous":
        what, advice = "has no <limit>: torque and speed are unlimited", "add effort and velocity"
        yield finding("warning", where, what, "none", "effort and velocity", advice)
        return
    if limit is None:
        yield finding("error", where, "has no <limit>", "none", "lower, upper, effort and velocity", "add it")
        return
    lacking = [key for key in ("effort", "velocity") if key not in limit.attrib]
    if lacking:
        got = f"no {' and no '.join(lacking)}"
        yield finding("error", where, "its <limit> lacks numbers", got, "effort and velocity", "add them")
        return
    given = [key for key in ("lower", "upper") if key in limit.attrib]
    yield from _efforts(where, limits["effort"], limits["velocity"], kind == "prismatic")
    if kind != "continuous":
        yield from _range(where, limits["lower"], limits["upper"], given, kind == "prismatic")


def _lock(joint: Element) -> str:
    """Return the argument that locks a joint, at zero or at the end of its range that is nearest to zero."""
    limit = joint.find("limit")
    ends = ("lower", "upper")
    try:
        lower, upper = (number(limit.get(key, "0")) if limit is not None else 0.0 for key in ends)
    except ValueError:
        lower = upper = 0.0
    position = min(max(0.0, lower), upper) if lower < upper else 0.0
    return f"models.load(..., locked={{'{joint.get('name', '')}': {position}}})"


def _range(where: str, lower: float, upper: float, given: Sequence[str], slides: bool) -> Iterator[Finding]:
    """Yield the findings about a joint's range, of which the file gives both ends, one or none."""
    got, widest, what = f"{lower:g} to {upper:g}", *((_LONG, "10 m") if slides else (_TURNS, "two turns"))
    if not np.isfinite(lower) or not np.isfinite(upper):
        advice = "correct it, or leave out both ends for a joint without them"
        yield finding("error", where, "range is not numeric", got, "two finite numbers", advice)
    elif not given or lower == upper == 0:  # many files write 0 for a range that they do not know
        got, advice = "<limit> without lower and upper, or with zeros", "add them, or make it 'continuous'"
        yield finding("warning", where, "has no range: Piaffe treats it as unlimited", got, "both", advice)
    elif lower > upper:
        yield finding("error", where, "range is reversed", got, "lower < upper", "exchange them")
    elif lower == upper:
        yield finding("error", where, "range is empty", got, "lower < upper", "give a range, or make it 'fixed'")
    elif len(given) == 1:
        advice = "Piaffe takes 0 for the other one, as URDF says"
        yield finding("warning", where, "range has one end", f"{given[0]} alone: {got}", "lower and upper", advice)
    elif upper - lower > widest:
        yield finding("warning", where, "range looks like a placeholder", got, f"less than {what}", "correct it")


def _efforts(where: str, effort: float, velocity: float, slides: bool) -> Iterator[Finding]:
    """Yield the findings about a joint's largest torque and speed."""
    torque, rate = ("force", "m/s") if slides else ("torque", "rad/s")
    for value, what, unit in ((effort, torque, "N" if slides else "Nm"), (velocity, "speed", rate)):
        got = f"{value:g} {unit}"
        if not 0 <= value < np.inf:
            expected = "a finite number ≥ 0"
            yield finding("error", where, f"{what} limit is impossible", got, expected, "correct it")
        elif value == 0 and what != "speed":
            expected = "a positive number for a motor"
            advice = "the joint is passive: it has no control; if it has a motor, give its limit"
            yield finding("warning", where, f"{what} limit is zero", got, expected, advice)
        elif value == 0:
            expected, advice = "a positive number", "Piaffe treats it as infinite"
            yield finding("warning", where, f"{what} limit is missing", got, expected, advice)
        elif value >= _PLACEHOLDER:
            expected = f"less than {_PLACEHOLDER:g}"
            yield finding("warning", where, f"{what} limit looks like a placeholder", got, expected, "correct it")


def _end(joint: Element, which: str) -> str:
    end = joint.find(which)
    return end.get("link", "") if end is not None else ""
