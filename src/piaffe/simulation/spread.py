"""Random initial states, so that the result of a controller does not depend on one initial state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import SamplingError
from piaffe.models import base, joints

from .perturbation import check_deviations

Array = NDArray[np.float64]

_OWN_STREAM = 1  # separates these random numbers from the perturbations of plans, which use the seed alone


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Standard deviations of random initial states; position and orientation of the base do not change.

    Args:
        joints: of every joint's angle [rad].
        joint_velocity: of every joint's velocity [rad/s].
        linear_velocity: of the base's linear velocity, per axis [m/s].
        angular_velocity: of the base's angular velocity, per axis [rad/s].

    Raises:
        SamplingError: a standard deviation is negative or not a number.
    """

    joints: float = 0.02
    joint_velocity: float = 0.1
    linear_velocity: float = 0.02
    angular_velocity: float = 0.05

    def __post_init__(self) -> None:
        check_deviations(self, "spread", SamplingError)

    def around(self, model: Any, x: ArrayLike, seed: int) -> Array:
        """Return a random state near another one; equal seeds return equal states.

        Args:
            model: the legged model of the state.
            x: state (nx,).
            seed: seed of the random numbers.
        """
        random = np.random.default_rng((seed, _OWN_STREAM))
        near = np.array(x, dtype=float)
        deviations = {
            joints.position: self.joints, joints.velocity: self.joint_velocity,
            base.linear_velocity: self.linear_velocity, base.angular_velocity: self.angular_velocity,
        }  # fmt: skip
        for quantity, deviation in deviations.items():
            where = model.state.slices[quantity]
            near[where] += deviation * random.standard_normal(near[where].shape)
        return near


STILL = Spread(joints=0.0, joint_velocity=0.0, linear_velocity=0.0, angular_velocity=0.0)
"""All seeds have the same initial state; they differ only in the perturbations of plans."""
