"""The spline through the nodes of a plan: a constant linear map from nodes to controls."""

from __future__ import annotations

import ctypes as ct
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import c_library, pointer

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spline:
    """The quadratic interpolating spline through uniform nodes, with breaks halfway between inner nodes.

    Args:
        knots: number n of intervals between nodes; there are n + 1 nodes, at least 3.
        steps: H; controls are at steps 0 … H, nodes at steps 0, H/n, …, H.
    """

    knots: int
    steps: int

    @cached_property
    def to_controls(self) -> Array:
        """The matrix W in controls = W nodes, (H + 1, n + 1)."""
        return np.ascontiguousarray(self.at(np.arange(self.steps + 1.0)))

    @cached_property
    def to_nodes(self) -> Array:
        """The matrix from controls to nodes, which are on the quadratic spline through all controls, (n + 1, H + 1)."""
        through = Spline(self.steps, self.steps) if self.steps >= 2 else self
        return through.at(np.linspace(0.0, self.steps, self.knots + 1))

    def controls(self, nodes: Array, centre: Array, half: Array) -> Array:
        """Return the controls of plans in their units, (N, H + 1, nu), clipped to their range.

        The spline can leave the range between nodes.

        Args:
            nodes: nodes of plans, scaled to [-1, 1], (N, n + 1, nu).
            centre: centre of the controls' range, (nu,).
            half: half the width of the range, (nu,).
        """
        library = _library()
        if library is None:
            return np.asarray(centre + half * np.clip(self.to_controls @ nodes, -1.0, 1.0))
        count = len(nodes)
        nodes, centre, half = (np.ascontiguousarray(each, dtype=float) for each in (nodes, centre, half))
        controls = np.empty((count, self.steps + 1, nodes.shape[2]))
        library.piaffe_controls(
            pointer(nodes), *map(ct.c_long, nodes.shape), pointer(self.to_controls), ct.c_long(self.steps + 1),
            pointer(centre), pointer(half), pointer(controls),
        )  # fmt: skip
        return controls

    def at(self, steps: Array) -> Array:
        """Return the matrix from nodes to values at steps (S,), (S, n + 1); beyond the ends, it extrapolates."""
        nodes = np.linspace(0.0, self.steps, self.knots + 1)
        return np.asarray(np.linalg.solve(self._basis(nodes).T, self._basis(np.asarray(steps)).T).T)

    def _basis(self, steps: Array) -> Array:
        """Return 1, s, s² and the truncated squares from each break on, (S, n + 1); s is in intervals between nodes."""
        s = steps * self.knots / self.steps
        breaks = np.arange(1.5, self.knots - 1)
        truncated = np.maximum(s[:, None] - breaks, 0.0) ** 2
        return np.column_stack([np.ones_like(s), s, s**2, truncated])


@lru_cache(maxsize=1)
def _library() -> ct.CDLL | None:
    loaded = c_library("piaffe.sampling.controllers", "spline", "controls of plans")
    if loaded is not None:
        loaded.piaffe_controls.restype = None
    return loaded
