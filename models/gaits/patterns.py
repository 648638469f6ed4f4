"""Named gaits, and :func:`gait` for a gait of your own: cyclic motions that name feet by their roles.

The durations are those published with CAFE-MPC. Each gait begins with a short stance on all feet.
"""

from __future__ import annotations

from typing import Any

from piaffe.errors import ProblemError

from ... import ocp
from ..stance import stance
from .reference import GaitReference

_ALL = "all"


def gait(*phases: tuple[str, str | tuple[str, ...], float], intro: float = 0.05, **command: Any) -> ocp.Motion:
    """Return a cyclic motion with a gait reference.

    Args:
        *phases: name, roles of the feet on the ground, and duration [s] of each phase of the cycle. Roles are
            ``"front"``, ``"front left"`` (feet that have both), ``"all"``, a tuple of these, or ``()`` for flight.
        intro: duration of a stance on all feet before the first cycle [s]; 0 for none.
        **command: ``speed``, ``yaw_rate``, … of :class:`GaitReference`.

    Raises:
        ProblemError: there is no phase, or a number of the command is out of range.
    """
    if not phases:
        raise ProblemError("gait: no phases - got none, expected at least one (name, roles, duration); add it")
    cycle = [ocp.Phase(name, stance(roles=roles), duration) for name, roles, duration in phases]
    once = (ocp.Phase("stand", stance(roles=_ALL), intro),) if intro > 0 else ()
    return ocp.Motion(*cycle, cyclic=True, once=once, reference=GaitReference(**command))


def walk(speed: float = 0.3, *, swing_time: float = 0.20, overlap_time: float = 0.05, **options: Any) -> ocp.Motion:
    """Return a walk: one foot swings at a time, in the order hind left, front left, hind right, front right.

    Args:
        speed: forward speed [m/s].
        swing_time: duration of the swing of each foot [s].
        overlap_time: duration for which all feet stand between two swings [s]; 0 for none.
        **options: as in :func:`gait`.
    """
    phases: list[tuple[str, str | tuple[str, ...], float]] = []
    for name, standing in (
        ("hind_left", ("front", "hind right")),
        ("front_left", ("hind", "front right")),
        ("hind_right", ("front", "hind left")),
        ("front_right", ("hind", "front left")),
    ):
        phases.append((name, standing, swing_time))
        if overlap_time > 0:
            phases.append(("overlap", _ALL, overlap_time))
    return gait(*phases, speed=speed, **options)


def trot(speed: float = 0.5, *, stance_time: float = 0.25, **options: Any) -> ocp.Motion:
    """Return a walking trot: the two diagonal pairs alternate. Options as in :func:`gait`."""
    return gait(
        ("left_diagonal", ("front left", "hind right"), stance_time),
        ("right_diagonal", ("front right", "hind left"), stance_time),
        speed=speed,
        **options,
    )


def flying_trot(
    speed: float = 0.5, *, stance_time: float = 0.15, flight_time: float = 0.10, **options: Any
) -> ocp.Motion:
    """Return a trot with flight between the diagonal pairs. Options as in :func:`gait`."""
    return gait(
        ("left_diagonal", ("front left", "hind right"), stance_time),
        ("flight", (), flight_time),
        ("right_diagonal", ("front right", "hind left"), stance_time),
        ("flight", (), flight_time),
        speed=speed,
        **options,
    )


def pace(speed: float = 0.5, *, stance_time: float = 0.25, **options: Any) -> ocp.Motion:
    """Return a pace: right feet, then left feet. Options as in :func:`gait`."""
    return gait(("right", "right", stance_time), ("left", "left", stance_time), speed=speed, **options)


def flying_pace(
    speed: float = 0.5, *, stance_time: float = 0.15, flight_time: float = 0.10, **options: Any
) -> ocp.Motion:
    """Return a pace with flight between the stances. Options as in :func:`gait`."""
    return gait(
        ("right", "right", stance_time),
        ("flight", (), flight_time),
        ("left", "left", stance_time),
        ("flight", (), flight_time),
        speed=speed,
        **options,
    )


def bound(speed: float = 0.5, *, stance_time: float = 0.10, flight_time: float = 0.10, **options: Any) -> ocp.Motion:
    """Return a bound: front feet, flight, hind feet, flight. Options as in :func:`gait`."""
    return gait(
        ("front", "front", stance_time),
        ("flight", (), flight_time),
        ("hind", "hind", stance_time),
        ("flight", (), flight_time),
        speed=speed,
        **options,
    )


def pronk(speed: float = 0.5, *, stance_time: float = 0.10, flight_time: float = 0.20, **options: Any) -> ocp.Motion:
    """Return a pronk: all feet, then flight. Options as in :func:`gait`."""
    return gait(("stance", _ALL, stance_time), ("flight", (), flight_time), speed=speed, **options)
