"""Feet of a loaded robot: names from frames, roles from where the feet are."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio
from numpy.typing import NDArray

from piaffe.errors import UnknownNameError

from ..doctor_text import Finding, finding
from ..robot import Foot, frame_index
from .description import leaf_frames
from .known import LEGS, KnownRobot

Array = NDArray[np.float64]

_NAMES = {
    **dict.fromkeys(("FL", "LF"), ("front", "left")),
    **dict.fromkeys(("FR", "RF"), ("front", "right")),
    **dict.fromkeys(("HL", "LH", "BL", "RL"), ("hind", "left")),
    **dict.fromkeys(("HR", "RH", "BR", "RR"), ("hind", "right")),
    **dict.fromkeys(("LEFT", "L"), ("left",)),
    **dict.fromkeys(("RIGHT", "R"), ("right",)),
    "FRONT": ("front",),
    **dict.fromkeys(("HIND", "REAR", "BACK"), ("hind",)),
}
"""Words of feet's names, and the roles that they say."""

_BESIDE_M = 1e-3  # less than this from the middle is neither front nor hind, neither left nor right


def feet_of_known(known: KnownRobot) -> list[Foot]:
    """Return the feet of a known robot."""
    return [
        Foot(leg, known.foot_frame.format(leg), frozenset(roles)) for leg, roles in zip(known.legs, LEGS, strict=True)
    ]


def feet_with_roles(
    model: pinocchio.Model, feet: Sequence[str] | Sequence[Foot] | Mapping[str, str]
) -> tuple[Foot, ...]:
    """Return feet with roles; where they are not given, by the feet's places at zero joint angles.

    Raises:
        UnknownNameError: the model has no such frame.
    """
    pairs = feet.items() if isinstance(feet, Mapping) else [(f, f) if isinstance(f, str) else ("", f) for f in feet]
    made = [frame if isinstance(frame, Foot) else Foot(_short(label), frame) for label, frame in pairs]
    for foot in made:
        if not model.existFrame(foot.frame):
            raise UnknownNameError(f"robot '{model.name}', foot '{foot.name}'", "frame", foot.frame, leaf_frames(model))
    if not made:
        return ()
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, pinocchio.neutral(model))
    places = np.array([data.oMf[frame_index(model, foot.frame)].translation[:2] for foot in made])
    centre = places.mean(axis=0)
    return tuple(
        foot if foot.roles else replace(foot, roles=_roles(xy - centre)) for foot, xy in zip(made, places, strict=True)
    )


def crossed_feet(feet: Sequence[Foot]) -> Iterator[Finding]:
    """Yield feet whose names say another side than the one where they are, by their roles."""
    for foot in feet:
        named = _sides(foot.name)
        for pair in (("front", "hind"), ("left", "right")):
            said, found = named & set(pair), foot.roles & set(pair)
            if said and found and said != found:
                where, got, expected = (
                    f"foot '{foot.name}'",
                    f"frame '{foot.frame}', {min(found)}",
                    f"a {min(said)} foot",
                )
                advice = "exchange the frames, or give roles with models.Foot"
                yield finding("warning", where, "its name and its place differ", got, expected, advice)


def _sides(name: str) -> set[str]:
    """Return the roles that a foot's name says: ``FL``, ``left_toe``, ``RH_FOOT``."""
    roles: set[str] = set()
    for word in re.split(r"[^A-Za-z]+", name):
        roles |= set(_NAMES.get(word.upper(), ()))
    return roles


def _roles(offset: Array) -> frozenset[str]:
    """Return the roles of a foot that lies at an offset (x forward, y left) from the middle of all feet."""
    roles = []
    if abs(offset[0]) > _BESIDE_M:
        roles.append("front" if offset[0] > 0 else "hind")
    if abs(offset[1]) > _BESIDE_M:
        roles.append("left" if offset[1] > 0 else "right")
    return frozenset(roles)


def _short(frame: str) -> str:
    """Return a foot's name from its frame's: ``FL_FOOT`` → ``FL``."""
    for ending in ("_foot", "_toe", "_ankle", "_contact"):
        if frame.lower().endswith(ending):
            return frame[: -len(ending)]
    return frame
