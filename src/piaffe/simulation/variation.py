"""What differs from seed to seed of an experiment: masses and friction of the plant, its first state, and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from piaffe.errors import ModelError

from .numbers import finite_number
from .perturbation import Perturbation
from .sensors import SensorNoise

_OWN_STREAM = 4  # separates these random numbers from those of Perturbation and Sensors with the same seed

NOISE = SensorNoise(
    position=0.003, orientation=0.005, joints=0.002, linear_velocity=0.03, angular_velocity=0.05, joint_velocity=0.1
)
"""Noise of a state that is estimated on a robot."""


@dataclass(frozen=True, kw_only=True)
class Variation:
    """What the seeds of an experiment draw; equal seeds draw equal numbers, whatever else is drawn.

    Args:
        mass: the base's mass and inertia are multiplied by a factor that is uniform within 1 ± mass, those of all other
            links by another one. 0 for the masses of the plant.
        friction: friction is uniform between these two; None for the friction of the plant.
        start: standard deviations of the first state.
        noise: standard deviations of the sensors.

    Raises:
        ModelError: a number is out of range.
    """

    mass: float = 0.05
    friction: tuple[float, float] | None = (0.5, 0.8)
    start: Perturbation = field(default_factory=Perturbation)
    noise: SensorNoise = NOISE

    def __post_init__(self) -> None:
        if not 0 <= finite_number("variation", "mass", self.mass) < 1:
            raise ModelError(
                f"variation: mass is out of range - got {self.mass!r}, expected a share of the mass, 0 to 1; change it"
            )
        if self.friction is not None:
            low, high = (finite_number("variation", "friction", each) for each in self.friction)
            if not 0 <= low <= high:
                raise ModelError(
                    f"variation: friction is out of range - got {low:g} to {high:g}, expected two numbers ≥ 0, the "
                    "smaller one first; change them"
                )

    def numbers(self, links: Sequence[str], seed: int) -> dict[str, Any]:
        """Return the arguments of ``Plant`` that a seed draws.

        Args:
            links: names of the plant's bodies, the base first.
            seed: of the random numbers.
        """
        base, others, slide = np.random.default_rng((seed, _OWN_STREAM)).uniform(-1.0, 1.0, 3).tolist()
        drawn: dict[str, Any] = {"noise": self.noise}
        if self.mass:
            factors = (1.0 + self.mass * base, 1.0 + self.mass * others)
            drawn["mass_scale"] = {name: factors[min(i, 1)] for i, name in enumerate(links)}
        if self.friction is not None:
            low, high = self.friction
            drawn["friction"] = 0.5 * (low + high) + 0.5 * (high - low) * slide
        return drawn
