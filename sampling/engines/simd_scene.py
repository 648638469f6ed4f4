"""A legged robot and its ground in numbers, as the SIMD engine simulates them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.models import Point, Tree

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Soft:
    """How hard a constraint is: MuJoCo's stiffness and damping of the reference, and its impedance.

    Args:
        stiffness: K of the reference acceleration −B v − K d r [1/s²].
        damping: B [1/s].
        impedance: d at the surface, d deep below, the width [m or rad], midpoint and power.
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
        joint: 0, 1, …
        lower: [rad].
        upper: [rad].
        soft: how hard they are.
    """

    joint: int
    lower: float
    upper: float
    soft: Soft


@dataclass(frozen=True, eq=False)
class Ground:
    """A geom of the world: the plane z = 0 of its frame, or a box.

    Args:
        place: of its frame, (3,) [m].
        axes: orientation of its frame, (3, 3).
        half: halves of a box's edges, (3,) [m]; None for a plane.
    """

    place: Array
    axes: Array
    half: Array | None


@dataclass(frozen=True, eq=False)
class Contact:
    """A ball of the robot that may touch a ground.

    Args:
        ball: index of the ball.
        ground: index of the ground.
        friction: coefficients along the two tangents.
        soft: how hard it is.
    """

    ball: int
    ground: int
    friction: tuple[float, float]
    soft: Soft


@dataclass(frozen=True, eq=False)
class Scene:
    """A floating base with hinges, whose balls touch planes and boxes.

    Args:
        tree: of links and hinges.
        armature: reflected inertia of every hinge, (n,) [kg m²].
        gravity: (3,) [m/s²].
        gain: of the actuators' controls, (n,).
        bias: of the actuators: constant, by angle, by speed, (n, 3).
        force_range: of the actuators' forces, infinite where there is none, (n, 2).
        balls: link and centre of every ball.
        radii: of the balls, (nb,) [m].
        grounds: what they may touch.
        contacts: pairs that may touch, in MuJoCo's order.
        limits: of joints, in MuJoCo's order.
        impratio: inverse ratio of friction's softness to the normal's.
        iterations: of PGS at most.
        enough: improvement below which PGS ends, in units of the cost.
        warm_start: begin from the accelerations of the step before.
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
