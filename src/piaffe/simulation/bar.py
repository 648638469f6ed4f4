"""The highest horizontal bar over which a motion passes without touching it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ShapeError

from .silhouette import Silhouette

Array = NDArray[np.float64]

_SLOPES = np.radians(np.arange(-89.0, 90.0, 1.0))


@dataclass(frozen=True)
class Bar:
    """A thin bar without ends, parallel to the ground.

    Args:
        height: above z = 0 [m]; 0 if the motion crosses no line of this direction.
        place: distance of the bar from the origin, to the left of its direction [m]; NaN without a bar.
        along: its direction in the ground plane [rad]; 0 is the world's x axis.
        lowest: index of the state in which a geom comes nearest to the bar from above; -1 without a bar.
    """

    height: float
    place: float
    along: float
    lowest: int


def highest_bar(model: Any, positions: ArrayLike, *, along: float = 0.0, step: float = 0.002) -> Bar:
    """Return the highest bar of a direction over which all moving geoms pass.

    In the vertical plane across the bar, with s across and z up, a convex geom with the support function h is above::

        z(s) = max over φ of (s sin φ − h(sin φ, −cos φ)) / cos φ

    The bar at s may be as high as the least z(s) of all geoms and states. All geoms are on one side of it in the first
    state, and on the other side in the last one. φ goes from −89° to 89° in steps of 1°, which makes geoms larger, by
    less than 0.5 % of their size, and never smaller. Between two states nothing is computed: give them close in time.

    Args:
        model: the ``mujoco.MjModel`` whose geoms count, as ``models.mujoco_model(robot, hull=True)``.
        positions: its ``qpos`` in the course of time, (T, nq) or more columns, as the states of an episode.
        along: direction of the bar [rad].
        step: distance between the places at which a bar is tried [m].

    Raises:
        ShapeError: there are too few positions or columns.
        ModelError: see :class:`Silhouette`.
    """
    given = np.asarray(positions, dtype=float)
    if given.ndim != 2 or len(given) < 2 or given.shape[1] < model.nq:
        raise ShapeError(
            f"bar: positions have the wrong size - got shape {given.shape}, expected at least two rows of {model.nq} "
            "or more numbers; give the states of an episode"
        )
    sides = np.array([[1.0, 0.0], [-1.0, 0.0]])
    down = np.column_stack([np.sin(_SLOPES), -np.cos(_SLOPES)])
    shape = Silhouette(model, np.vstack([sides, down]), along)
    first, last = (_span(shape.extents(given[i, : model.nq])) for i in (0, -1))
    low, high = min(first[1], last[1]), max(first[0], last[0])
    if low >= high:
        return Bar(0.0, np.nan, along, -1)
    places = np.arange(low, high, step)
    least, lowest = np.full(len(places), np.inf), np.full(len(places), -1)
    for i, row in enumerate(given):
        bottom = _bottom(shape.extents(row[: model.nq]), places)
        lower = bottom < least
        least[lower], lowest[lower] = bottom[lower], i
    best = int(np.argmax(least))
    return Bar(max(float(least[best]), 0.0), float(places[best]), along, int(lowest[best]))


def _span(extents: Array) -> tuple[float, float]:
    """Return the least and the largest s of the geoms."""
    return -float(extents[:, 1].max()), float(extents[:, 0].max())


def _bottom(extents: Array, places: Array) -> Array:
    """Return the lowest z of the geoms at each place; infinite where there is none."""
    bottom = np.full(len(places), np.inf)
    for right, left, *below in extents:
        at = (places <= right) & (places >= -left)
        if at.any():
            lines = (places[at, None] * np.sin(_SLOPES) - np.array(below)) / np.cos(_SLOPES)
            bottom[at] = np.minimum(bottom[at], lines.max(axis=1))
    return bottom
