"""References: where a motion's targets come from - keyframes, arrays, a saved trajectory, or a gait's heuristics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError, UnknownNameError

from . import rotation
from .frame import PlanarFrame, carry, relative
from .model import ModelBase, Sample
from .quantity import Quantity
from .trajectory import Trajectory

if TYPE_CHECKING:
    from .motion import Piece

Array = NDArray[np.float64]


class BoundReference(ABC):
    """A reference placed in the world for one model."""

    @abstractmethod
    def sample(self, t: float, phase: int) -> Sample:
        """Return the targets at local time t [s]; ``phase`` (running index in the piece) decides the side of a boundary."""


class Reference(ABC):
    """A source of targets, before it is known for which robot and where."""

    @abstractmethod
    def bind(self, model: ModelBase, piece: Piece, start: Sample, frame: PlanarFrame) -> BoundReference:
        """Place the reference.

        Args:
            model: the first model of the schedule.
            piece: the piece of motion it belongs to; its phases and their times.
            start: targets at the piece's start, in the world.
            frame: planar frame (x, y, yaw) [m, m, rad] that the piece is carried to; the origin for the first piece.
        """


@dataclass(frozen=True)
class _Curve:
    """Knots of one quantity; rotations as roll-pitch-yaw."""

    times: Array
    values: Array

    def value(self, t: float) -> Array:
        return np.array([np.interp(t, self.times, column) for column in self.values.T])

    def rate(self, t: float, side: float) -> Array:
        """Return the slope of the piece of curve on the side of t that ``side`` (±1) names; zero beyond the ends."""
        last = len(self.times) - 1
        i = int(np.searchsorted(self.times, t + side * 1e-9, side="right")) - 1
        if i < 0 or i >= last:
            return np.zeros(self.values.shape[1])
        return (self.values[i + 1] - self.values[i]) / (self.times[i + 1] - self.times[i])


@dataclass(frozen=True)
class BoundKeyframes(BoundReference):
    """The path through keyframes: piecewise linear, orientation in roll-pitch-yaw so that its winding is kept."""

    curves: Mapping[Quantity, _Curve]
    rates: Mapping[Quantity, Quantity]
    ends: Array
    start: Sample

    def rpy(self, quantity: Quantity, t: float) -> Array:
        """Return a rotation's interpolated roll, pitch, yaw with its winding, (3,) [rad]."""
        return self.curves[quantity].value(t)

    def sample(self, t: float, phase: int) -> Sample:
        """Return the targets; velocities are the path's derivative unless keyframes give them."""
        side = -1.0 if phase < len(self.ends) and t >= self.ends[phase] - 1e-9 else 1.0
        sample: dict[Quantity, Array] = dict(self.start)
        for quantity, curve in self.curves.items():
            value = curve.value(t)
            sample[quantity] = rotation.np_from_rpy(value) if quantity.kind == "rotation" else value
        for velocity, position in self.rates.items():
            if velocity in self.curves:
                continue
            if position not in self.curves:
                if velocity in self.start:
                    sample[velocity] = np.zeros_like(np.asarray(self.start[velocity]))
                continue
            rate = self.curves[position].rate(t, side)
            if position.kind == "rotation":
                rate = rotation.np_body_rate(self.curves[position].value(t), rate)
            sample[velocity] = rate
        return sample


@dataclass(frozen=True)
class KeyframeModels:
    """Several models that share a motion: each entry of a keyframe goes to the first that knows it."""

    models: tuple[ModelBase, ...]

    def keyframe(self, values: Mapping[str, object]) -> dict[Quantity, Array]:
        """Translate a keyframe's entries to quantities."""
        targets: dict[Quantity, Array] = {}
        for name, value in values.items():
            for number, model in enumerate(self.models):
                try:
                    targets.update(model.keyframe({name: value}))
                    break
                except UnknownNameError:
                    if number == len(self.models) - 1:
                        self.models[0].keyframe({name: value})
        return targets


@dataclass(frozen=True)
class Keyframes(Reference):
    """The reference of phases that carry keyframes: knots of a path that starts at the piece's start."""

    def bind(self, model: ModelBase, piece: Piece, start: Sample, frame: PlanarFrame) -> BoundReference:
        """Lay the knots; quantities without any keep their starting value."""
        return self.bind_all((model,), piece, start, frame)

    def bind_all(self, models: tuple[ModelBase, ...], piece: Piece, start: Sample, frame: PlanarFrame) -> BoundReference:
        """Lay the knots of a motion that several models share."""
        blocks = {b.quantity: b for model in models for b in model.state.blocks}
        resolver = KeyframeModels(models)
        knots: dict[Quantity, list[tuple[float, Array]]] = {}
        t = 0.0
        for phase in piece.phases:
            t += phase.duration
            if phase.target is None:
                continue
            for quantity, value in resolver.keyframe(phase.target.values).items():
                if quantity not in knots:
                    first = start.get(quantity, np.zeros_like(value))
                    first = rotation.np_to_rpy(np.asarray(first)) if quantity.kind == "rotation" else np.asarray(first)
                    knots[quantity] = [(0.0, first)]
                if quantity.kind == "rotation":
                    value = value + np.array([0.0, 0.0, frame[2]])
                    if len(knots[quantity]) == 1:  # the start's own angles lie in (-pi, pi]: begin on the nearest branch
                        first = knots[quantity][0][1]
                        first[2] += 2 * np.pi * round((value[2] - first[2]) / (2 * np.pi)) if frame[2] else 0.0
                else:
                    value = carry({quantity: value}, frame)[quantity]
                knots[quantity].append((t, value))
        curves = {
            quantity: _Curve(np.array([k[0] for k in pairs]), np.array([k[1] for k in pairs]))
            for quantity, pairs in knots.items()
        }
        rates = {b.quantity: b.rate_of for b in blocks.values() if b.rate_of is not None}
        ends = np.cumsum([phase.duration for phase in piece.phases])
        return BoundKeyframes(curves, rates, ends, start)


@dataclass(frozen=True)
class _BoundArrays(BoundReference):
    trajectory: Trajectory
    starts: Array
    motion: PlanarFrame

    def sample(self, t: float, phase: int) -> Sample:
        index = min(phase, len(self.trajectory.phases) - 1)
        part = self.trajectory.phases[index]
        return carry(part.sample(t - self.starts[index] + part.times[0]), self.motion)


@dataclass(frozen=True)
class FromTrajectory(Reference):
    """Targets read from a trajectory, carried to where the piece begins."""

    trajectory: Trajectory

    def bind(self, model: ModelBase, piece: Piece, start: Sample, frame: PlanarFrame) -> BoundReference:
        """Carry the trajectory's own first planar frame onto the piece's."""
        first = self.trajectory.phases[0]
        own = model.planar_frame(first.sample(first.times[0]))
        starts = np.cumsum([0.0] + [phase.duration for phase in piece.phases])[:-1]
        return _BoundArrays(self.trajectory, starts, relative(frame, own))


@dataclass(frozen=True)
class _BoundTable(BoundReference):
    times: Array
    columns: Mapping[Quantity, Array]
    start: Sample
    frame: PlanarFrame

    def sample(self, t: float, phase: int) -> Sample:
        sample: dict[Quantity, Array] = {}
        for quantity, values in self.columns.items():
            value = np.array([np.interp(t, self.times, column) for column in values.T])
            sample[quantity] = value / np.linalg.norm(value) if quantity.kind == "rotation" else value
        return {**self.start, **carry(sample, self.frame)}


class FromArrays(Reference):
    """Targets read from arrays over time, linearly interpolated.

    Args:
        times: increasing times since the piece's start, (n,) [s].
        columns: quantity → values (n, size); rotations as quaternions (n, 4) of one sign branch.
    """

    def __init__(self, times: ArrayLike, columns: Mapping[Quantity, ArrayLike]) -> None:
        self.times = np.asarray(times, dtype=float)
        self.columns = {q: np.asarray(v, dtype=float).reshape(len(self.times), -1) for q, v in columns.items()}
        if self.times.ndim != 1 or np.any(np.diff(self.times) <= 0):
            raise ProblemError("FromArrays: times are unusable - got a sequence that does not increase, expected one that does; sort it")  # fmt: skip
        for quantity, values in self.columns.items():
            if not np.all(np.isfinite(values)):
                raise ProblemError(f"FromArrays, '{quantity}': values are unusable - got NaN or infinity, expected finite numbers; mend them")  # fmt: skip

    def bind(self, model: ModelBase, piece: Piece, start: Sample, frame: PlanarFrame) -> BoundReference:
        """Carry the arrays' origin onto the piece's frame."""
        return _BoundTable(self.times, self.columns, start, frame)

