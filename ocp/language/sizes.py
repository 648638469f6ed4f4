"""Natural sizes of a model's lengths, times and masses, and of the quantities with units made of them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from piaffe.errors import ModelError

from .manifold import Array, Manifold

_FACTOR = re.compile(r"([A-Za-z]+)(?:\^(-?\d+))?")
_UNITS = {
    "m": (1, 0, 0), "s": (0, 1, 0), "kg": (0, 0, 1), "Hz": (0, -1, 0), "N": (1, -2, 1), "Nm": (2, -2, 1),
    "J": (2, -2, 1), "W": (2, -3, 1), "Pa": (-1, -2, 1), "rad": (0, 0, 0), "deg": (0, 0, 0),
}  # fmt: skip
"""Powers of length, time and mass of each unit."""


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Natural sizes of a model: a solver counts its lengths, times and masses in these, in place of SI units.

    Regularisation, weights and tolerances of defects, and the barrier are relative to them. So similar models (all
    lengths times a factor, with masses, times and weights to match) take the same iterations.

    Args:
        length: a length [m].
        time: a time [s].
        mass: a mass [kg].

    Raises:
        ModelError: one is not a positive number.
    """

    length: float = 1.0
    time: float = 1.0
    mass: float = 1.0

    def __post_init__(self) -> None:
        for name in ("length", "time", "mass"):
            value = getattr(self, name)
            if not (isinstance(value, int | float) and 0 < value < float("inf")):
                raise ModelError(f"sizes: {name} is out of range - got {value!r}, expected a positive number; give one")

    def of(self, unit: str) -> float:
        """Return the natural size of a quantity in its unit; 1 if the unit is empty or not known.

        Args:
            unit: an SI unit, ``"m"``, ``"rad/s^2"``, ``"kg m^2/s"``. What follows a ``/`` is below the line.
        """
        length, time, mass = _powers(unit)
        return self.length**length * self.time**time * self.mass**mass

    def of_space(self, space: Manifold) -> Array:
        """Return the natural size of each component of a difference of two states or controls, (ndx,)."""
        return np.array([self.of(block.quantity.unit) for block in space.blocks for _ in block.labels])


@lru_cache(maxsize=200)
def _powers(unit: str) -> tuple[int, int, int]:
    """Return the powers of length, time and mass in a unit; zeros if a part of it is not known."""
    above, *below = unit.split("/")
    total = (0, 0, 0)
    for part, sign in ((above, 1), *((each, -1) for each in below)):
        for name, power in _FACTOR.findall(part):
            if name not in _UNITS:
                return 0, 0, 0
            length, time, mass = (sign * int(power or 1) * each for each in _UNITS[name])
            total = total[0] + length, total[1] + time, total[2] + mass
    return total
