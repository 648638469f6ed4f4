"""Check what readers of URDF files disagree about: the form of numbers, names, and parts that are there twice."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Severity = Literal["error", "warning", "note"]

_NUMBER = re.compile(r" *[+-]?((\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|inf|nan)", re.ASCII)
_ONE_TURN = 2 * np.pi + 0.01  # angles beyond it are not radians

ONCE = {
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("parent", "child", "origin", "axis", "limit", "mimic"),
}
"""Parts of which a tag has one at most; Pinocchio takes the first."""


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


def number(text: str) -> float:
    """Return a number of a URDF file; NaN and infinity are numbers here.

    Python reads more than the reader of Pinocchio, which drops the whole part without an error: ``1_0``, ``0.3`` with a
    space behind it, digits of other scripts.

    Raises:
        ValueError: it is none.
    """
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"{text!r} is not a number")
    return float(text)


def numbers(text: str) -> Array:
    """Return numbers that are separated by spaces; raise ValueError if there is something else."""
    return np.array([number(each) for each in text.split(" ") if each])


def examine_names(root: Element) -> Iterator[Finding]:
    """Yield robots, links and joints without a name, and names that several links or several joints have."""
    if not root.get("name"):
        yield finding("error", "robot", "has no name", "<robot> without 'name'", "<robot name='...'>", "give it one")
    for kind in ("link", "joint"):
        names = [each.get("name", "") for each in root.findall(kind)]
        for name in sorted({name for name in names if names.count(name) > 1 or not name}):
            got = f"{names.count(name)} of that name"
            what = "its name is not unique" if name else "has no name"
            yield finding("error", f"{kind} '{name}'", what, got, "one", f"rename the {kind}s")


def examine_parts(where: str, tag: Element) -> Iterator[Finding]:
    """Yield parts of a link or a joint that are there twice: a reader would take one of them without a word."""
    for owner in (tag, *tag.findall("inertial")):
        for name in ONCE[owner.tag]:
            count = len(owner.findall(name))
            if count > 1:
                what, got = f"has several <{name}>", f"{count} in <{owner.tag}>"
                yield finding("error", where, what, got, "one", "remove the others")


def examine_origin(where: str, parent: Element) -> Iterator[Finding]:
    """Yield angles of an ``<origin>`` beyond a turn; raise ValueError unless it holds three numbers each."""
    origin = parent.find("origin")
    if origin is None:
        return
    for key in ("xyz", "rpy"):
        text = origin.get(key, "0 0 0")
        found = numbers(text)
        if found.shape != (3,) or not np.all(np.isfinite(found)):
            raise ValueError(f"{key}={text!r} of <origin> is not three finite numbers")
    angles = numbers(origin.get("rpy", "0 0 0"))
    if np.any(np.abs(angles) > _ONE_TURN):
        got = f"rpy={origin.get('rpy', '')!r} of <origin> in <{parent.tag}>"
        expected = "radians, at most one turn"
        yield finding("warning", where, "an angle is beyond one turn", got, expected, "check the unit: rad")
