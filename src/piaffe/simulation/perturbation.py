"""Random perturbations of the state in which a plan is begun."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError, PiaffeError
from piaffe.models import Mujoco, base, joints
from piaffe.models.terrain import Flat

Array = NDArray[np.float64]

_OWN_STREAM = 2  # separates these random numbers from those of Spread and of plans with the same seed


@dataclass(frozen=True, kw_only=True)
class Perturbation:
    """Standard deviations of the first state of a simulation about the first state of the plan.

    The perturbation is in the tangent, x ⊕ δ: the rotation of the base is about its own axes. The base is then moved
    vertically so that the lowest foot is as high above the ground as in the plan, because a foot cannot begin below it.

    Args:
        joints: of every joint's angle [rad].
        orientation: of the base's orientation, per axis [rad].
        linear_velocity: of the base's linear velocity, per axis [m/s].
        angular_velocity: of the base's angular velocity, per axis [rad/s].

    Raises:
        ModelError: a standard deviation is negative or not a number.
    """

    joints: float = 0.010
    orientation: float = 0.010
    linear_velocity: float = 0.025
    angular_velocity: float = 0.050

    def __post_init__(self) -> None:
        check_deviations(self, "perturbation", ModelError)

    def scaled(self, factor: float) -> Perturbation:
        """Return the perturbation with all standard deviations times a factor."""
        return replace(self, **{field.name: factor * getattr(self, field.name) for field in fields(self)})

    def around(self, model: Mujoco, x: ArrayLike, seed: int) -> Array:
        """Return a random state near another one, (nx,); equal seeds return equal states.

        Args:
            model: the plant.
            x: state (nx,).
            seed: seed of the random numbers.
        """
        random, space = np.random.default_rng((seed, _OWN_STREAM)), model.state
        start, delta = np.asarray(x, dtype=float), np.zeros(space.ndx)
        deviations = {
            joints.position: self.joints, base.orientation: self.orientation,
            base.linear_velocity: self.linear_velocity, base.angular_velocity: self.angular_velocity,
        }  # fmt: skip
        for quantity, deviation in deviations.items():
            if quantity not in space.tangent_slices:  # the base is fixed
                continue
            where = space.tangent_slices[quantity]
            delta[where] = deviation * random.standard_normal(delta[where].shape)
        near = space.np_plus(start, delta)
        if base.position in space.slices:
            near[2] += _lowest(model, start) - _lowest(model, near)
        return near


def _lowest(model: Mujoco, x: Array) -> float:
    """Return the height of the lowest foot, on a terrain above where it would stand [m]."""
    where = model.state.slices
    pose = (x[None, where[quantity]] for quantity in (base.position, base.orientation, joints.position))
    feet = model.kinematics.world_feet(*pose)
    if isinstance(model.terrain, Flat):
        return float(feet[..., 2].min())
    return float((feet - model.terrain.standing(feet[..., :2], model.robot.foot_radius))[..., 2].min())


def check_deviations(given: Any, where: str, error: type[PiaffeError]) -> None:
    """Raise an error of this class if a field of a dataclass is not a standard deviation: finite, at least 0."""
    for field in fields(given):
        value = getattr(given, field.name)
        if isinstance(value, bool) or not (isinstance(value, int | float) and 0 <= value < float("inf")):
            raise error(
                f"{where}: {field.name} is out of range - got {value!r}, expected a standard deviation, at least 0; "
                "change it"
            )
