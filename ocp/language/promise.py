"""What a model promises about its motions beyond one step: points that rest, and points that fall freely.

A step that is exact on its own can still carry a resting point away, a little per step. A verification recomputes these
promises from the states alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as cs


@dataclass(frozen=True)
class Resting:
    """A point that rests on the ground while a flag is 1, for example a foot.

    Args:
        name: its name.
        flag: 1 in stages in which it rests, 0 in others, (1, 1), of p.
        position: its position in the world, (3, 1) [m], of x and p.
        height: its distance from the ground, (1, 1) [m], of x and p; 0 while it rests.
    """

    name: str
    flag: cs.SX
    position: cs.SX
    height: cs.SX


@dataclass(frozen=True)
class Falling:
    """A point that falls freely while a flag is 1, for example the centre of mass of a robot in flight.

    Args:
        name: its name.
        flag: 1 in stages in which it falls, 0 in others, (1, 1), of p.
        position: its position in the world, (3, 1) [m], of x and p.
        velocity: its velocity, (3, 1) [m/s], of x and p.
        gravity: its acceleration, (3, 1) [m/s²], of p.
    """

    name: str
    flag: cs.SX
    position: cs.SX
    velocity: cs.SX
    gravity: cs.SX


@dataclass(frozen=True)
class Promises:
    """What a model promises in one of its modes.

    Args:
        resting: points that do not move, and stay on the ground, from the start of their rest to its end.
        falling: points on a parabola from the start of their flight to its end.
    """

    resting: tuple[Resting, ...] = ()
    falling: tuple[Falling, ...] = ()
