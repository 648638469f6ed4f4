"""Perturbations: standard normal numbers, and the standard deviations of a plan's nodes in each stage."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from ..options import Options

Array = NDArray[np.float64]


def deviations(options: Options, stage: int, stages: int) -> Array:
    """Return the standard deviation of every node in a stage, (n + 1,), in units of half a control's range.

    Args:
        options: options; ``noise`` is the schedule.
        stage: index i of the stage, from 0.
        stages: number of stages of this plan.
    """
    back = options.knots - np.arange(options.knots + 1.0)
    if options.noise == "factors":
        return np.asarray(options.sigma * options.stage_factor**stage * options.node_factor**back)
    exponent = stage / (options.stage_factor * stages) + back / (options.node_factor * options.knots)
    return np.asarray(options.sigma * np.exp(-exponent))


class Noise:
    """A sequence of arrays of standard normal numbers. A thread computes the next array while the last one is used.

    Args:
        seed: equal seeds give equal numbers.
        shape: shape of each array, (N, knots + 1, nu); node 0 is zero, because its control is applied already.
        pool: a pool with one thread.
    """

    def __init__(self, seed: int, shape: tuple[int, int, int], pool: ThreadPoolExecutor) -> None:
        self._random, self._shape, self._pool = np.random.default_rng(seed), shape, pool
        self._next: Future[Array] | None = None

    def __call__(self) -> Array:
        """Return the next array, (N, knots + 1, nu); the caller may change it."""
        drawn = self._draw() if self._next is None else self._next.result()
        self._next = self._pool.submit(self._draw)
        return drawn

    def _draw(self) -> Array:
        n, nodes, nu = self._shape
        noise = np.zeros(self._shape)
        noise[:, 1:] = self._random.standard_normal((n, nodes - 1, nu))
        return noise
