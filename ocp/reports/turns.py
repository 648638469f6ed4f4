"""Warnings about orientations: many turns in a phase, and quaternions in another order."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from math import pi

import numpy as np
from numpy.typing import NDArray

from ..compiler import CompiledProblem
from ..language import Cost, ProblemWarning, placed_phases, rotation
from ..language.reference import BoundKeyframes

Array = NDArray[np.float64]

MOST_TURNS = 1.5
"""More turns in one phase are reported: angles in degrees are the usual cause."""
UPRIGHT = 0.5
"""A rotation by less than this counts as upright [rad]."""


def many_turns(compiled: CompiledProblem) -> Iterator[ProblemWarning]:
    """Yield the keyframes whose angles differ from those before them by more than ``MOST_TURNS`` turns."""
    pieces = compiled.path.pieces
    for placed in islice(placed_phases(pieces), sum(len(piece.phases) for piece in pieces)):
        piece = compiled.path.placed[placed.piece]
        reference = piece.reference
        if not isinstance(reference, BoundKeyframes):
            continue
        start, end = placed.start - piece.start, placed.end - piece.start
        for quantity in reference.curves:
            if quantity.kind != "rotation":
                continue
            change = reference.rpy(quantity, end) - reference.rpy(quantity, start)
            axis = int(np.argmax(np.abs(change)))
            if abs(change[axis]) <= MOST_TURNS * 2 * pi:
                continue
            phase = placed.phase
            angle = ("roll", "pitch", "yaw")[axis]
            own = phase.target is not None and {"rpy", quantity.path} & set(phase.target.values)
            left_out = "" if own else ", on the way to the next keyframe that has one"
            yield ProblemWarning(
                f"phase '{phase.name}' ({phase.source}), keyframe",
                f"{angle} changes by many turns - got {change[axis]:.4g} rad, "
                f"{abs(change[axis]) / 2 / pi:.1f} turns, in {phase.duration:g} s{left_out}, expected at most "
                f"{MOST_TURNS:g} turns; give radians ({change[axis]:.4g} degrees: {np.deg2rad(change[axis]):.4g} rad)",
                phase.source,
            )


def far_angles(compiled: CompiledProblem) -> Iterator[ProblemWarning]:
    """Yield costs whose own target is an angle of more than ``MOST_TURNS`` turns."""
    for term in compiled.terms:
        if not isinstance(term, Cost) or term.target is None or term.unit != "rad" or not term.target.size:
            continue
        worst = float(term.target.ravel()[np.argmax(np.abs(term.target))])
        if abs(worst) > MOST_TURNS * 2 * pi:
            yield ProblemWarning(
                term.where,
                f"its target is many turns - got {worst:.4g} rad, {abs(worst) / 2 / pi:.1f} turns, expected at most "
                f"{MOST_TURNS:g} turns; give radians ({worst:.4g} degrees are {np.deg2rad(worst):.4g} rad)",
                term.source,
            )


def other_order(compiled: CompiledProblem) -> Iterator[ProblemWarning]:
    """Yield quaternions of the initial state that are upright only if read as (x, y, z, w).

    A quaternion is not reported if the path's first keyframe is nearer to it as given.
    """
    state, x = compiled.phases[0].mode.state, compiled.initial
    for quantity, part in state.slices.items():
        if quantity.kind != "rotation":
            continue
        given = x[part]
        other = given[[3, 0, 1, 2]]
        phase = compiled.phases[-1]
        target = (
            compiled.path.sample(float(phase.times[-1]), phase.interval).get(quantity) if _turned(compiled) else None
        )
        goal = np.array([1.0, 0.0, 0.0, 0.0]) if target is None else np.asarray(target)
        if _angle(given, goal) > pi / 2 and _angle(other, goal) < UPRIGHT:
            yield ProblemWarning(
                f"problem ({compiled.source})",
                f"'{quantity}' of the initial state is far from upright - got {np.round(given, 4).tolist()} as "
                f"(w, x, y, z), a turn of {_angle(given, np.array([1.0, 0.0, 0.0, 0.0])):.2f} rad, expected about "
                f"(1, 0, 0, 0); if it is (x, y, z, w), put w first: {np.round(other, 4).tolist()}",
                compiled.source,
            )


def _turned(compiled: CompiledProblem) -> bool:
    """Return whether a keyframe of the motion has angles of its own."""
    references = [piece.reference for piece in compiled.path.placed]
    return any(
        quantity.kind == "rotation"
        for each in references
        if isinstance(each, BoundKeyframes)
        for quantity in each.curves
    )


def _angle(a: Array, b: Array) -> float:
    """Return the angle between two orientations [rad]."""
    return float(np.linalg.norm(rotation.np_log(rotation.np_multiply(rotation.np_conjugate(a), b))))
