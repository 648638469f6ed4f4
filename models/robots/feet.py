"""Feet of a loaded robot: names from frames, roles from where the feet are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio
from numpy.typing import NDArray

from piaffe.errors import UnknownNameError

from ..robot import Foot
from .description import leaf_frames
from .known import LEGS, KnownRobot

Array = NDArray[np.float64]

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
    places = np.array([data.oMf[model.getFrameId(foot.frame)].translation[:2] for foot in made])
    centre = places.mean(axis=0)
    return tuple(
        foot if foot.roles else replace(foot, roles=_roles(xy - centre)) for foot, xy in zip(made, places, strict=True)
    )


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
