"""The numbers of a legged robot and its ground that the SIMD engine uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.models import Point, Tree

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Soft:
    """Softness of a constraint: stiffness and damping of MuJoCo's reference acceleration, and the impedance.

    Args:
        stiffness: K of the reference acceleration −B v − K d r [1/s²].
        damping: B [1/s].
        impedance: d at distance zero, d at the full width, the width [m or rad], midpoint and power.
        inverse_mass: MuJoCo's estimate of the diagonal of J M⁻¹ Jᵀ [1/kg, or 1/(kg m²)].
    """

    stiffness: float
    damping: float
    impedance: tuple[float, float, float, float, float]
    inverse_mass: float


@dataclass(frozen=True, eq=False)
class Limit:
    """Limits of a joint's angle.

    Args:
        joint: index of the joint, 0, 1, …
        lower: [rad].
        upper: [rad].
        soft: softness of the limits.
    """

    joint: int
    lower: float
    upper: float
    soft: Soft


@dataclass(frozen=True, eq=False)
class Ground:
    """A geom of the world: the plane z = 0 of its frame, or a box.

    Args:
        place: position of its frame, (3,) [m].
        axes: orientation of its frame, (3, 3).
        half: half lengths of a box's edges, (3,) [m]; None for a plane.
    """

    place: Array
    axes: Array
    half: Array | None


@dataclass(frozen=True, eq=False)
class Contact:
    """A pair of a ball of the robot and a ground that can be in contact.

    Args:
        ball: index of the ball.
        ground: index of the ground.
        friction: coefficients along the two tangents.
        soft: softness of the contact.
    """

    ball: int
    ground: int
    friction: tuple[float, float]
    soft: Soft


@dataclass(frozen=True, eq=False)
class Scene:
    """A floating base with hinges, and balls that can be in contact with planes and boxes.

    Args:
        tree: tree of links and hinges.
        armature: reflected inertia of every hinge, (n,) [kg m²].
        gravity: (3,) [m/s²].
        gain: gain of each actuator, (n,).
        bias: bias of each actuator: constant, times the angle, times the velocity, (n, 3).
        force_range: limits of the actuators' forces, infinite without limits, (n, 2).
        balls: link and centre of every ball.
        radii: radii of the balls, (nb,) [m].
        grounds: planes and boxes of the world.
        contacts: pairs of a ball and a ground, in MuJoCo's order.
        limits: limits of joints, in MuJoCo's order.
        impratio: ratio of the impedance of friction to that of the normal.
        iterations: largest number of iterations of PGS.
        enough: improvement of the cost below which PGS ends.
        warm_start: whether PGS starts from the accelerations of the step before.
        timestep: [s].
    """

    tree: Tree
    armature: Array
    gravity: Array
    gain: Array
    bias: Array
    force_range: Array
    balls: tuple[Point, ...]
    radii: Array
    grounds: tuple[Ground, ...]
    contacts: tuple[Contact, ...]
    limits: tuple[Limit, ...]
    impratio: float
    iterations: int
    enough: float
    warm_start: bool
    timestep: float
