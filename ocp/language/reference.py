"""References: the sources of a motion's targets - keyframes, arrays, or a saved trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError, ShapeError, UnknownNameError

from . import rotation
from .frame import PlanarFrame, relative, transform
from .model import ModelBase, Sample
from .phase import Phase
from .piece import BoundReference, Piece, Reference
from .quantity import Quantity
from .source import caller
from .time import SAME_TIME
from .trajectory import Trajectory
from .user_input import numbers_of

Array = NDArray[np.float64]

_OFF_UNIT = 0.1  # rows of another precision are nearer to unit length


@dataclass(frozen=True)
class _Curve:
    """Knots of one quantity; rotations as roll-pitch-yaw."""

    times: Array
    values: Array

    def value(self, t: float) -> Array:
        i = min(max(int(np.searchsorted(self.times, t, side="right")) - 1, 0), len(self.times) - 2)
        share = min(max((t - self.times[i]) / (self.times[i + 1] - self.times[i]), 0.0), 1.0)
        return np.asarray((1.0 - share) * self.values[i] + share * self.values[i + 1])

    def rate(self, t: float, side: float) -> Array:
        """Return the slope just before t (``side`` = −1) or just after t (``side`` = 1); zero beyond the ends."""
        last = len(self.times) - 1
        i = int(np.searchsorted(self.times, t + side * SAME_TIME, side="right")) - 1
        if i < 0 or i >= last:
            return np.zeros(self.values.shape[1])
        return np.asarray((self.values[i + 1] - self.values[i]) / (self.times[i + 1] - self.times[i]))


@dataclass(frozen=True)
class BoundKeyframes(BoundReference):
    """The path through keyframes: piecewise linear, orientation in roll, pitch, yaw so that full turns are kept."""

    curves: Mapping[Quantity, _Curve]
    rates: Mapping[Quantity, Quantity]
    ends: Array
    start: Sample

    def rpy(self, quantity: Quantity, t: float) -> Array:
        """Return a rotation's interpolated roll, pitch, yaw, full turns included, (3,) [rad]."""
        return self.curves[quantity].value(t)

    def sample(self, t: float, phase: int) -> Sample:
        """Return the targets; a velocity without keyframes is the derivative of the path."""
        side = -1.0 if phase < len(self.ends) and t >= self.ends[phase] - SAME_TIME else 1.0
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


def translate(models: tuple[ModelBase, ...], values: Mapping[str, object]) -> dict[Quantity, Array]:
    """Translate a keyframe for several models: the first model that has a target of an entry's name translates it."""
    targets: dict[Quantity, Array] = {}
    for model in models:
        values = model.complete_keyframe(values)
    for name, value in values.items():
        errors = []
        for model in models:
            try:
                targets.update(model.keyframe({name: value}))
                break
            except UnknownNameError as error:
                errors.append(error)
        else:
            raise errors[0]
    return targets


def place_keyframes(
    models: tuple[ModelBase, ...], phases: tuple[Phase, ...], start: Sample, frame: PlanarFrame
) -> BoundKeyframes:
    """Return the path through the keyframes of phases; quantities without a keyframe keep their value at the start."""
    knots: dict[Quantity, list[tuple[float, Array]]] = {}
    t = 0.0
    for phase in phases:
        t += phase.duration
        for quantity, value in translate(models, phase.target.values if phase.target else {}).items():
            if quantity.kind == "rotation":
                value = value + np.array([0.0, 0.0, frame[2]])
            else:
                value = transform({quantity: value}, frame)[quantity]
            if quantity not in knots:
                first: Array = np.asarray(start.get(quantity, np.zeros_like(value)), dtype=float)
                if quantity.kind == "rotation":
                    first = _angles(first, value, frame[2]) if quantity in start else np.zeros(3)
                knots[quantity] = [(0.0, first)]
            knots[quantity].append((t, value))
    curves = {
        quantity: _Curve(np.array([k[0] for k in pairs]), np.array([k[1] for k in pairs]))
        for quantity, pairs in knots.items()
    }
    blocks = [block for model in models for block in model.state.blocks]
    rates = {block.quantity: block.rate_of for block in blocks if block.rate_of is not None}
    return BoundKeyframes(curves, rates, np.cumsum([phase.duration for phase in phases]), start)


def _angles(q: Array, toward: Array, yaw: float) -> Array:
    """Return a quaternion's roll, pitch, yaw, (3,) [rad], such that the path to the next keyframe is short.

    Up to full turns, two triples of angles describe one rotation. The result is the one closer to ``toward``. If its
    pitch exceeds π/2, it differs from that of ``np_to_rpy``. Its yaw is within π of the frame's yaw.
    """
    usual = rotation.np_to_rpy(q)
    other = _wrapped(np.array([usual[0] + np.pi, np.pi - usual[1], usual[2] + np.pi]))
    nearer = min(usual, other, key=lambda angles: float(np.linalg.norm(_wrapped(angles - toward))))
    return np.asarray(nearer + np.array([0.0, 0.0, 2 * np.pi * round((yaw - nearer[2]) / (2 * np.pi))]))


def _wrapped(angles: Array) -> Array:
    return np.asarray(angles - 2 * np.pi * np.round(angles / (2 * np.pi)))


class BoundCycles(BoundReference):
    """Keyframes of a cyclic piece: the phases that run once, then cycles, each from the end of the previous one."""

    def __init__(self, models: tuple[ModelBase, ...], piece: Piece, start: Sample, frame: PlanarFrame) -> None:
        self.models, self.piece = models, piece
        phases = piece.once or piece.cycle
        self._parts = [(0.0, phases, place_keyframes(models, phases, start, frame))]

    @property
    def start(self) -> Sample:
        """The sample at the piece's start."""
        return self._parts[0][2].start

    def sample(self, t: float, phase: int) -> Sample:
        """Return the targets; the index of the phase, counted over all cycles, selects the cycle."""
        once, cycle = len(self.piece.once), len(self.piece.cycle)
        number, index = divmod(phase - once, cycle) if phase >= once else (-1, phase)
        began, _, keyframes = self._part(number + bool(once))
        return keyframes.sample(t - began, index)

    def _part(self, number: int) -> tuple[float, tuple[Phase, ...], BoundKeyframes]:
        while len(self._parts) <= number:
            began, phases, keyframes = self._parts[-1]
            length = sum(phase.duration for phase in phases)
            end = keyframes.sample(length, len(phases) - 1)
            following = place_keyframes(self.models, self.piece.cycle, end, self.models[0].planar_frame(end))
            self._parts.append((began + length, self.piece.cycle, following))
        return self._parts[number]


@dataclass(frozen=True)
class Keyframes(Reference):
    """The reference of phases with keyframes: a path from the piece's start through the keyframes."""

    def bind(self, model: ModelBase, piece: Piece, start: Sample, frame: PlanarFrame) -> BoundReference:
        """Return the path through the keyframes; quantities without a keyframe keep their value at the start."""
        return self.bind_all((model,), piece, start, frame)

    def bind_all(
        self, models: tuple[ModelBase, ...], piece: Piece, start: Sample, frame: PlanarFrame
    ) -> BoundReference:
        """Return the path of a motion for several models; each cycle begins at the end of the previous one."""
        if piece.cycle:
            return BoundCycles(models, piece, start, frame)
        return place_keyframes(models, piece.phases, start, frame)


@dataclass(frozen=True)
class _BoundArrays(BoundReference):
    trajectory: Trajectory
    starts: Array
    motion: PlanarFrame

    def sample(self, t: float, phase: int) -> Sample:
        index = min(phase, len(self.trajectory.phases) - 1)
        part = self.trajectory.phases[index]
        return transform(part.sample(t - self.starts[index] + part.times[0]), self.motion)


@dataclass(frozen=True)
class FromTrajectory(Reference):
    """Targets from a trajectory, moved to the start of the piece."""

    trajectory: Trajectory

    def bind(self, model: ModelBase, piece: Piece, start: Sample, frame: PlanarFrame) -> BoundReference:
        """Move the trajectory so that its first planar frame is the piece's."""
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
        return {**self.start, **transform(sample, self.frame)}


class FromArrays(Reference):
    """Targets from arrays over time, linearly interpolated.

    Args:
        times: increasing times since the piece's start, (n,) [s].
        columns: quantity (or the name of a state or control of an ``ocp.Model``) → values (n, size); rotations as
            quaternions (n, 4) without jumps of sign.
    """

    def __init__(self, times: ArrayLike, columns: Mapping[Quantity | str, ArrayLike]) -> None:
        self.source = caller()
        where = f"FromArrays ({self.source})"
        self.times: Array = numbers_of(times, where, "times")
        if self.times.ndim != 1 or self.times.size == 0 or not np.all(np.diff(self.times) > 0):
            raise ProblemError(
                f"{where}: times are unusable - got a sequence that does not increase, expected one that does; sort it"
            )
        self.columns: dict[Quantity, Array] = {}
        for key, given in columns.items():
            quantity = Quantity(key) if isinstance(key, str) else key
            values: Array = numbers_of(given, where, f"'{quantity}'")
            if values.shape[:1] != self.times.shape:
                raise ShapeError(
                    f"{where}, '{quantity}': wrong number of rows - got {values.shape[:1]}, expected "
                    f"{self.times.size}, one per time; remove or add rows"
                )
            self.columns[quantity] = values.reshape(self.times.size, -1)
        for quantity, values in self.columns.items():
            if not np.all(np.isfinite(values)):
                raise ProblemError(
                    f"{where}, '{quantity}': values are unusable - got NaN or infinity, expected finite numbers; "
                    "fix them"
                )
            if quantity.kind == "rotation" and np.any(np.abs(np.linalg.norm(values, axis=1) - 1) > _OFF_UNIT):
                row = int(np.argmax(np.abs(np.linalg.norm(values, axis=1) - 1)))
                raise ProblemError(
                    f"{where}, '{quantity}': values are no quaternions - got {values[row].tolist()} in row {row}, "
                    "expected unit length, w first; scale them"
                )

    def bind(self, model: ModelBase, piece: Piece, start: Sample, frame: PlanarFrame) -> BoundReference:
        """Move the arrays so that their origin is the piece's frame."""
        return _BoundTable(self.times, self.columns, start, frame)
