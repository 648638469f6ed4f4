"""Targets: a sample of a motion as one vector, and where the parameters of a node take parts of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from ..language import ModelBase, PlanarFrame, Quantity, Sample, rotation, transform_value

Array = NDArray[np.float64]
Indices = NDArray[np.int_]


class Copies(NamedTuple):
    """Entries of a parameter vector or state that are entries of a sample vector: ``p[to] = s[of]``."""

    to: tuple[int, ...]
    of: tuple[int, ...]


@dataclass(frozen=True)
class TargetVector:
    """The quantities of a sample vector, in order.

    Args:
        quantities: the quantities.
        sizes: number of stored entries of each.
        initial: value of each at the motion's start; it applies where a reference has none.
    """

    quantities: tuple[Quantity, ...]
    sizes: tuple[int, ...]
    initial: tuple[Array, ...]

    @property
    def size(self) -> int:
        """Number of entries of a sample vector."""
        return sum(self.sizes)

    @cached_property
    def slices(self) -> Mapping[str, slice]:
        """The slice of each quantity, by its path."""
        ends = np.cumsum([0, *self.sizes])
        return {q.path: slice(int(ends[i]), int(ends[i + 1])) for i, q in enumerate(self.quantities)}

    def pack(self, sample: Sample) -> Array:
        """Return a sample as a vector, (size,); rotations have unit length."""
        by_path = {quantity.path: value for quantity, value in sample.items()}
        parts = []
        for quantity, size, initial in zip(self.quantities, self.sizes, self.initial, strict=True):
            value = np.ravel(np.asarray(by_path.get(quantity.path, initial), dtype=float))
            if quantity.kind == "rotation":
                value = value / np.linalg.norm(value)
            parts.append(np.resize(value, size))  # the tables name a value of another size
        return np.concatenate([np.zeros(0), *parts])

    def unpack(self, s: Array) -> dict[Quantity, Array]:
        """Return the quantities of sample vectors (..., size)."""
        return {q: s[..., part] for q, part in zip(self.quantities, self.slices.values(), strict=True)}

    def moved(self, s: Array, motion: PlanarFrame) -> Array:
        """Return sample vectors (..., size) moved by a planar motion."""
        parts = [transform_value(quantity, value, motion) for quantity, value in self.unpack(s).items()]
        return np.concatenate([np.zeros((*s.shape[:-1], 0)), *parts], axis=-1)

    def of_function(self, quantities: Sequence[tuple[Quantity, int]]) -> tuple[int, ...]:
        """Return, per entry, the entry of another sample vector with the same quantity; -1 where it has none."""
        slices: dict[str, tuple[int, int]] = {}
        at = 0
        for quantity, size in quantities:
            slices[quantity.path] = (at, size)
            at += size
        places: list[int] = []
        for quantity, size in zip(self.quantities, self.sizes, strict=True):
            first, own = slices.get(quantity.path, (-1, 0))
            places += range(first, first + size) if own == size else [-1] * size
        return tuple(places)

    def state_copies(self, model: ModelBase) -> Copies:
        """Return where the state of a model takes the sample."""
        to: list[int] = []
        of: list[int] = []
        for quantity, part in model.state.slices.items():
            to += range(part.start, part.stop)
            of += range(self.slices[quantity.path].start, self.slices[quantity.path].stop)
        return Copies(tuple(to), tuple(of))

    def acting_copies(self, model: ModelBase) -> Copies:
        """Return what a stage of a model takes from the sample of its middle, see ``ModelBase.acting``."""
        own = {quantity.path for quantity in model.acting}
        both = tuple(i for path, part in self.slices.items() if path in own for i in range(part.start, part.stop))
        return Copies(both, both)


def moved_symbols(parts: Sequence[tuple[Quantity, cs.SX]], motion: cs.SX) -> list[cs.SX]:
    """Return the values of quantities, as CasADi columns, moved by a planar motion (x, y, yaw)."""
    x, y, yaw = cs.vertsplit(motion)
    c, s = cs.cos(yaw), cs.sin(yaw)
    turn = cs.vertcat(cs.cos(yaw / 2), 0, 0, cs.sin(yaw / 2))
    found = []
    for quantity, value in parts:
        if quantity.kind == "rotation":
            value = rotation.multiply(turn, value)
        elif quantity.kind != "vector":
            shift = (x, y) if quantity.kind == "point" else (0, 0)
            rows = []
            for i in range(0, value.numel(), 3):
                rows += [c * value[i] - s * value[i + 1] + shift[0], s * value[i] + c * value[i + 1] + shift[1]]
                rows.append(value[i + 2])
            value = cs.vertcat(*rows)
        found.append(value)
    return found
