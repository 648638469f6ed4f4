"""Annealing: standard deviations of a plan's nodes, stage by stage."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .options import Options

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
