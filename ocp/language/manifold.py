"""State spaces: named blocks of numbers, some of them unit quaternions, with ⊕ and ⊖."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ShapeError, UnknownNameError

from . import rotation
from .quantity import Quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Block:
    """One named part of a state or control.

    Args:
        quantity: the quantity that the part stores.
        labels: one name per tangent component.
        rate_of: for a velocity, the quantity of which it is the rate. A velocity without keyframes gets the derivative
            of that quantity's targets as its target.
    """

    quantity: Quantity
    labels: tuple[str, ...]
    rate_of: Quantity | None = None

    @property
    def ndx(self) -> int:
        """Tangent dimension."""
        return len(self.labels)

    @property
    def nx(self) -> int:
        """Number of stored components: 4 for a rotation."""
        return 4 if self.quantity.kind == "rotation" else len(self.labels)


@dataclass(frozen=True)
class Manifold:
    """An ordered tuple of blocks; the state space of a model, or (all vectors) its control space."""

    blocks: tuple[Block, ...]

    @cached_property
    def nx(self) -> int:
        """Number of stored components."""
        return sum(block.nx for block in self.blocks)

    @cached_property
    def ndx(self) -> int:
        """Tangent dimension."""
        return sum(block.ndx for block in self.blocks)

    @cached_property
    def slices(self) -> Mapping[Quantity, slice]:
        """The slice of each quantity's stored components."""
        ends = np.cumsum([0] + [block.nx for block in self.blocks])
        return {b.quantity: slice(int(ends[i]), int(ends[i + 1])) for i, b in enumerate(self.blocks)}

    @cached_property
    def tangent_slices(self) -> Mapping[Quantity, slice]:
        """The slice of each quantity's tangent components."""
        ends = np.cumsum([0] + [block.ndx for block in self.blocks])
        return {b.quantity: slice(int(ends[i]), int(ends[i + 1])) for i, b in enumerate(self.blocks)}

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """One name per tangent component, e.g. ``"base.position x"``."""
        return tuple(f"{b.quantity} {label}" for b in self.blocks for label in b.labels)

    @cached_property
    def stored_labels(self) -> tuple[str, ...]:
        """One name per stored component, e.g. ``"base.orientation w"``."""
        parts = ((b, ("w", "x", "y", "z") if b.quantity.kind == "rotation" else b.labels) for b in self.blocks)
        return tuple(f"{b.quantity} {label}".strip() for b, labels in parts for label in labels)

    def block(self, quantity: Quantity | str) -> Block:
        """Return the block of a quantity (or of its path)."""
        for block in self.blocks:
            if block.quantity.path == str(quantity):
                return block
        raise UnknownNameError("state", "quantity", str(quantity), [b.quantity.path for b in self.blocks])

    def pack(self, values: Mapping[Quantity, Array]) -> Array:
        """Stack the values of every block, (..., nx)."""
        parts = []
        for block in self.blocks:
            value = np.asarray(values[block.quantity], dtype=float)
            if value.shape[-1] != block.nx:
                raise ShapeError(
                    f"quantity '{block.quantity}': wrong size - got {value.shape[-1]} entries, expected {block.nx} "
                    f"({', '.join(block.labels)}) [{block.quantity.unit}]; give one per component"
                )
            parts.append(value)
        return np.concatenate(parts, axis=-1)

    def unpack(self, x: Array) -> dict[Quantity, Array]:
        """Split an array (..., nx) into its blocks."""
        return {quantity: x[..., part] for quantity, part in self.slices.items()}

    # ---- CasADi

    def plus(self, x: cs.SX, dx: cs.SX) -> cs.SX:
        """Return x ⊕ δ, (nx, 1)."""
        parts = []
        for block in self.blocks:
            value, step = x[self.slices[block.quantity]], dx[self.tangent_slices[block.quantity]]
            rotates = block.quantity.kind == "rotation"
            parts.append(rotation.multiply(value, rotation.exp(step)) if rotates else value + step)
        return cs.vertcat(*parts)

    def minus(self, x1: cs.SX, x0: cs.SX) -> cs.SX:
        """Return x1 ⊖ x0 = δ with x0 ⊕ δ = x1, (ndx, 1)."""
        parts = []
        for block in self.blocks:
            a, b = x1[self.slices[block.quantity]], x0[self.slices[block.quantity]]
            rotates = block.quantity.kind == "rotation"
            parts.append(rotation.log(rotation.multiply(rotation.conjugate(b), a)) if rotates else a - b)
        return cs.vertcat(*parts)

    def nudge(self, x: cs.SX, dx: cs.SX) -> cs.SX:
        """Return x + ∂(x ⊕ δ)/∂δ|₀ δ: equal to x ⊕ δ to first order, without Exp; the compiler differentiates it."""
        parts = []
        for block in self.blocks:
            value, step = x[self.slices[block.quantity]], dx[self.tangent_slices[block.quantity]]
            if block.quantity.kind == "rotation":
                parts.append(value + 0.5 * rotation.multiply(value, cs.vertcat(0, step)))
            else:
                parts.append(value + step)
        return cs.vertcat(*parts)

    def minus_near(self, x1: cs.SX, x0: cs.SX) -> cs.SX:
        """Return a δ that equals x1 ⊖ x0 to first order at x1 = x0, without Log; the compiler differentiates it."""
        parts = []
        for block in self.blocks:
            a, b = x1[self.slices[block.quantity]], x0[self.slices[block.quantity]]
            rotates = block.quantity.kind == "rotation"
            parts.append(2 * rotation.multiply(rotation.conjugate(b), a)[1:] if rotates else a - b)
        return cs.vertcat(*parts)

    # ---- NumPy, over any leading axes

    def np_plus(self, x: Array, dx: Array) -> Array:
        """Return x ⊕ δ, (..., nx); rotations are normalised."""
        parts = []
        for block in self.blocks:
            value, step = x[..., self.slices[block.quantity]], dx[..., self.tangent_slices[block.quantity]]
            if block.quantity.kind == "rotation":
                rotated = rotation.np_multiply(value, rotation.np_exp(step))
                parts.append(rotated / np.linalg.norm(rotated, axis=-1, keepdims=True))
            else:
                parts.append(value + step)
        return np.concatenate(parts, axis=-1)

    def np_minus(self, x1: Array, x0: Array) -> Array:
        """Return x1 ⊖ x0, (..., ndx)."""
        parts = []
        for block in self.blocks:
            a, b = x1[..., self.slices[block.quantity]], x0[..., self.slices[block.quantity]]
            if block.quantity.kind == "rotation":
                parts.append(rotation.np_log(rotation.np_multiply(rotation.np_conjugate(b), a)))
            else:
                parts.append(a - b)
        return np.concatenate(parts, axis=-1)

    def np_normalise(self, x: Array) -> Array:
        """Return x with its quaternions scaled to unit length, (..., nx)."""
        x = np.array(x, dtype=float)
        for block in self.blocks:
            if block.quantity.kind == "rotation":
                part = self.slices[block.quantity]
                x[..., part] /= np.linalg.norm(x[..., part], axis=-1, keepdims=True)
        return x
