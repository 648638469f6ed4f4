"""Sensors of a plant: noise by kind, and what an estimator reads."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.models import base, joints
from piaffe.ocp import Manifold, rotation

from .perturbation import check_deviations

Array = NDArray[np.float64]

_OWN_STREAM = 3  # separates these random numbers from those of Spread and Perturbation with the same seed


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """Standard deviations of what sensors measure, of a zero-mean normal distribution, independent at every reading.

    Position and linear velocity of the base are for a plant whose base is measured from outside; an estimator does
    without them and uses the acceleration.

    Args:
        position: of the base, per axis [m].
        orientation: of the base, per axis [rad].
        joints: of every joint's angle [rad].
        linear_velocity: of the base, per axis [m/s].
        angular_velocity: of the base, per axis [rad/s].
        joint_velocity: of every joint [rad/s].
        acceleration: of the accelerometer, per axis [m/s²].

    Raises:
        ModelError: a standard deviation is negative or not a number.
    """

    position: float = 0.0
    orientation: float = 0.0
    joints: float = 0.0
    linear_velocity: float = 0.0
    angular_velocity: float = 0.0
    joint_velocity: float = 0.0
    acceleration: float = 0.0

    def __post_init__(self) -> None:
        check_deviations(self, "sensor noise", ModelError)

    def scaled(self, factor: float) -> SensorNoise:
        """Return the noise with all standard deviations times a factor."""
        return replace(self, **{field.name: factor * getattr(self, field.name) for field in fields(self)})


@dataclass(frozen=True, eq=False)
class Reading:
    """What sensors on the robot measure at one time.

    Args:
        acceleration: specific force on the base's origin in base axes, a − g, the mean since the last reading (3,)
            [m/s²].
        angular_velocity: of the base in its axes (3,) [rad/s].
        orientation: of the base, a unit quaternion, w first (4,).
        joint_position: (n,) [rad].
        joint_velocity: (n,) [rad/s].
        touching: 1 for feet whose measured force says that they are on the ground (nf,).
        planned: 1 for feet that are on the ground in the plan (nf,); NaN if that is not known.
    """

    acceleration: Array
    angular_velocity: Array
    orientation: Array
    joint_position: Array
    joint_velocity: Array
    touching: Array
    planned: Array


class Sensors:
    """Sensors with noise, whose random numbers follow from a seed.

    Args:
        noise: standard deviations.
        space: the state space of the plant.
        gravity: (3,) [m/s²].
        seed: of the random numbers.
    """

    def __init__(self, noise: SensorNoise, space: Manifold, gravity: Array, seed: int) -> None:
        self._noise, self._space, self._gravity = noise, space, gravity
        self._random = np.random.default_rng((seed, _OWN_STREAM))
        self._deviation = np.zeros(space.ndx)
        kinds: dict[Any, float] = {
            base.position: noise.position, base.orientation: noise.orientation, joints.position: noise.joints,
            base.linear_velocity: noise.linear_velocity, base.angular_velocity: noise.angular_velocity,
            joints.velocity: noise.joint_velocity,
        }  # fmt: skip
        for quantity, deviation in kinds.items():
            self._deviation[space.tangent_slices[quantity]] = deviation
        self._silent = not self._deviation.any()

    def state(self, x: Array) -> Array:
        """Return a measured state, (nx,)."""
        if self._silent:
            return x
        return self._space.np_plus(x, self._deviation * self._random.standard_normal(self._space.ndx))

    def reading(self, x: Array, before: Array, elapsed: float, touching: Array, planned: Array) -> Reading:
        """Return what the sensors on the robot measure.

        Args:
            x: the state (nx,).
            before: the state at the last reading (nx,).
            elapsed: time since then [s]; 0 at the first reading.
            touching: 1 for feet on the ground by their force (nf,).
            planned: 1 for feet on the ground in the plan (nf,).
        """
        where, measured = self._space.slices, self.state(x)
        change = x[where[base.linear_velocity]] - before[where[base.linear_velocity]]
        world = (change / elapsed if elapsed > 0 else np.zeros(3)) - self._gravity
        to_base = rotation.np_matrix(x[where[base.orientation]][None])[0].T
        noise = self._noise.acceleration * self._random.standard_normal(3) if self._noise.acceleration else 0.0
        return Reading(
            acceleration=to_base @ world + noise, angular_velocity=measured[where[base.angular_velocity]],
            orientation=measured[where[base.orientation]], joint_position=measured[where[joints.position]],
            joint_velocity=measured[where[joints.velocity]], touching=touching, planned=planned,
        )  # fmt: skip
