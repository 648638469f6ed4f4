"""Invariants of a model's motions over many steps: points in contact do not move, ballistic points follow parabolas.

A step that is exact on its own can still move a point in contact away, a little per step. A verification recomputes the
invariants from the states alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as cs


@dataclass(frozen=True)
class ContactPoint:
    """A point that stays where it is on the ground while a flag is 1, for example a foot.

    Args:
        name: its name.
        flag: 1 in stages in which it is in contact, 0 in others, (1, 1), of p.
        position: its position in the world, (3, 1) [m], of x and p.
        height: its distance from the ground, (1, 1) [m], of x and p; 0 in contact.
    """

    name: str
    flag: cs.SX
    position: cs.SX
    height: cs.SX


@dataclass(frozen=True)
class BallisticPoint:
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
class Invariants:
    """The invariants of a model in one of its modes.

    Args:
        contacts: points that do not move, and stay on the ground, from the start of their contact to its end.
        ballistic: points on a parabola from the start of their flight to its end.
    """

    contacts: tuple[ContactPoint, ...] = ()
    ballistic: tuple[BallisticPoint, ...] = ()
