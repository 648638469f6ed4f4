"""Check the feet of a robot: whether they can move, and reach the ground."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .doctor_text import Finding, finding
from .kinematics import Kinematics
from .robot import ROOT, Robot

_NARROW = 0.05  # a workspace thinner than this fraction of the leg's reach is a line or a plane


def examine_feet(robot: Robot) -> Iterator[Finding]:
    """Yield feet that cannot reach the ground, or cannot move in all three directions."""
    legs = Kinematics(robot)
    _, places = legs.workspace
    joints = {int(foot): group.joints[m] for group in legs.groups for m, foot in enumerate(group.feet)}
    first = [p.translation[2] for j, p in enumerate(robot.model.jointPlacements) if robot.model.parents[j] == ROOT]
    for i, foot in enumerate(robot.feet):
        where = f"foot '{foot.name}'"
        if i not in joints:
            got, expected = "no joint between base and foot", "a leg"
            yield finding("error", where, "is fixed to the base", got, expected, "choose another frame")
            continue
        others = [robot.feet[k].name for k in joints if k != i and set(joints[k]) & set(joints[i])]
        if others:
            got, expected = f"joints in common with {others}", "one leg per foot"
            yield finding("warning", where, "shares joints with another foot", got, expected, "keep one foot per leg")
        spread = np.linalg.svd(places[:, i] - places[:, i].mean(axis=0), compute_uv=False) / np.sqrt(len(places))
        if spread[2] < _NARROW * legs.reach[i]:
            deviations = ", ".join(f"{s:.3f}" for s in spread)
            got = f"{len(joints[i])} joints and a workspace with standard deviations {deviations} m"
            expected = f"more than {_NARROW * legs.reach[i]:.3f} m in each of three directions"
            advice = "check its joints and their ranges"
            yield finding("warning", where, "cannot move in all three directions", got, expected, advice)
        lowest = float(places[:, i, 2].min())
        if lowest - robot.foot_radius > min(first):
            got, expected = f"{lowest:.3f} m at its lowest", f"below the legs' first joints at {min(first):.3f} m"
            yield finding("error", where, "does not reach the ground", got, expected, "check its frame and joints")
        if len(foot.roles) < 2:
            got, expected = " ".join(sorted(foot.roles)) or "none", "front or hind, and left or right"
            advice = "gaits that are written in roles may leave it out"
            yield finding("note", where, "has fewer than two roles", got, expected, advice)
