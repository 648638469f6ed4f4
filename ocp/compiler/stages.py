"""Stages: the motion phase and the targets of each stage of a part of the horizon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..language import ModelBase, Path, PlacedPhase, Sample
from .timeline import HorizonPhase

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stages:
    """The stages of a part of the horizon, and its last node.

    A stage of a model with a phase per mode belongs to one motion phase. In a stage of another model the contacts may
    change. If they act on the model (``ModelBase.acting``), the stage belongs to the phase at its middle, which takes
    up more of it; else to the phase at its start.

    Args:
        intervals: motion phase of each stage, and of the last node (N+1).
        samples: the motion at the nodes (N+1).
        acting: the motion where the stages take what acts during them, and at the last node (N+1).
        tracked: targets of the costs of each stage and of the last node (N+1).
        acts: times of ``acting`` (N+1) [s].
    """

    intervals: tuple[PlacedPhase, ...]
    samples: tuple[Sample, ...]
    acting: tuple[Sample, ...]
    tracked: tuple[Sample, ...]
    acts: tuple[float, ...]


def stages_of(span: HorizonPhase, times: Array, placed: list[PlacedPhase], path: Path) -> Stages:
    """Return the stages of a part of the horizon.

    Args:
        span: the part.
        times: times of its nodes (N+1) [s].
        placed: the motion phases up to its end.
        path: the motion's targets.
    """
    model, last = span.model, float(times[-1])
    begins = [span.interval_at(float(t), placed) for t in times[:-1]]
    begins.append(span.interval if model.cut_by_modes else path.interval_before(last))
    samples = tuple(path.sample(float(t), interval) for t, interval in zip(times, begins, strict=True))
    if not model.acting:
        return Stages(tuple(begins), samples, samples, samples, tuple(map(float, times)))
    middles = [float(t) + span.segment.dt / 2 for t in times[:-1]]
    inside = [span.interval_at(t, placed) for t in middles]
    acting = tuple(path.sample(t, interval) for t, interval in zip(middles, inside, strict=True))
    tracked = tuple(with_acting(model, *both) for both in zip(samples[:-1], acting, strict=True))
    acts = (*middles, last)
    return Stages((*inside, begins[-1]), samples, (*acting, samples[-1]), (*tracked, samples[-1]), acts)


def with_acting(model: ModelBase, start: Sample, middle: Sample) -> Sample:
    """Return the targets of a stage: those of its start, but at its middle what acts during the whole stage."""
    return {**start, **{quantity: value for quantity, value in middle.items() if quantity in model.acting}}
