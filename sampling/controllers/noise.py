"""Perturbations: normal numbers, and the standard deviations of a plan's nodes, stage by stage."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from ..options import Options

Array = NDArray[np.float64]


def deviations(options: Options, stage: int, stages: int) -> Array:
    """Return the standard deviation of every node at a stage, (n + 1,), in halves of a control's range.

    Args:
        options: with the schedule, ``noise``.
        stage: i, from 0.
        stages: how many there are in this plan.
    """
    back = options.knots - np.arange(options.knots + 1.0)
    if options.noise == "factors":
        return np.asarray(options.sigma * options.stage_factor**stage * options.node_factor**back)
    exponent = stage / (options.stage_factor * stages) + back / (options.node_factor * options.knots)
    return np.asarray(options.sigma * np.exp(-exponent))


class Noise:
    """Standard normal numbers, array after array, each drawn in a thread of its own while the last one is being used.

    Args:
        seed: equal seeds give equal numbers.
        shape: of an array, (N, knots + 1, nu); node 0, which is being applied, has zeros.
        pool: of one thread.
    """

    def __init__(self, seed: int, shape: tuple[int, int, int], pool: ThreadPoolExecutor) -> None:
        self._random, self._shape, self._pool = np.random.default_rng(seed), shape, pool
        self._next: Future[Array] | None = None

    def __call__(self) -> Array:
        """Return the next array, (N, knots + 1, nu); it is the caller's to change."""
        drawn = self._draw() if self._next is None else self._next.result()
        self._next = self._pool.submit(self._draw)
        return drawn

    def _draw(self) -> Array:
        n, nodes, nu = self._shape
        noise = np.zeros(self._shape)
        noise[:, 1:] = self._random.standard_normal((n, nodes - 1, nu))
        return noise
