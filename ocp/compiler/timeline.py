"""The timeline: a motion's phases, a schedule's segments and the horizon, on one time axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piaffe.errors import ProblemError

from ..language import SAME_TIME, ModelBase, Motion, Path, PlacedPhase, Schedule, Segment, is_same_time, model_of


@dataclass(frozen=True)
class HorizonPhase:
    """A part of the horizon with one model and time step, and (if the model is cut by modes) one motion phase.

    Args:
        segment: the model and its time step.
        interval: the motion phase at its start.
        start: time since the motion's start [s].
        num_stages: number of stages N.
        ends_phase: whether its last node is the end of a motion phase.
        following: the motion phase after its last node; None at the motion's end.
    """

    segment: Segment
    interval: PlacedPhase
    start: float
    num_stages: int
    ends_phase: bool
    following: PlacedPhase | None

    @property
    def model(self) -> ModelBase:
        """The segment's model."""
        return model_of(self.segment)

    @property
    def end(self) -> float:
        """Time of the last node [s]."""
        return self.start + self.num_stages * self.segment.dt

    def interval_at(self, t: float, intervals: list[PlacedPhase]) -> PlacedPhase:
        """Return the motion phase of a stage that begins at t; the later one on a boundary."""
        if self.model.cut_by_modes:
            return self.interval
        current = self.interval
        for interval in intervals:
            if interval.start <= t + SAME_TIME:
                current = interval
        return current


def whole_steps(length: float, dt: float, where: str) -> int:
    """Return length / dt if it is a whole number; otherwise raise an error with the two nearest lengths."""
    steps = round(length / dt)
    if steps >= 1 and is_same_time(steps * dt, length):
        return steps
    below = int((length + SAME_TIME) / dt)
    choices = f"{max(below, 1) * dt:g} or {(max(below, 1) + (1 if below else 0)) * dt:g}" if below else f"{dt:g}"
    raise ProblemError(
        f"{where}: not a whole number of steps - got {length:g} s with dt {dt:g} s, expected {choices} s; choose one, "
        "or another dt"
    )


def horizon_phases(path: Path, schedule: Schedule, t0: float) -> list[HorizonPhase]:
    """Return the parts of a horizon that begins at t0 [s], rounded to a multiple of the first model's dt."""
    total = path.duration
    dt0 = schedule.segments[0].dt
    t = round(t0 / dt0) * dt0 if np.isfinite(t0) else t0
    if not 0 <= t < total - SAME_TIME:
        raise ProblemError(
            f"horizon: start is outside the motion - got t0 = {t0:g} s, expected 0 ≤ t0 < {total:g} s; choose one "
            "inside"
        )
    spans: list[HorizonPhase] = []
    for segment in schedule.segments:
        where = f"schedule ({segment.source}), model '{model_of(segment).name}'"
        if segment.duration is None:
            if total == float("inf"):
                raise ProblemError(
                    f"{where}: the motion never ends - got until_end on a cyclic motion, expected a finite one; use "
                    ".cycles(n) or .over(duration, dt)"
                )
            end = total
        else:
            end = t + segment.duration
            if end > total + SAME_TIME:
                raise ProblemError(
                    f"{where}: the horizon is longer than the motion - got {end:g} s, expected at most {total:g} s; "
                    "shorten it or add phases"
                )
        intervals = [i for i in path.intervals(end) if i.end > t + SAME_TIME]
        parts = intervals if model_of(segment).cut_by_modes else [intervals[0]]
        for interval in parts:
            stop = min(interval.end, end) if model_of(segment).cut_by_modes else end
            place = (
                f"phase '{interval.phase.name}' ({interval.phase.source})" if model_of(segment).cut_by_modes else where
            )
            if stop - t <= SAME_TIME:
                continue
            steps = whole_steps(stop - t, segment.dt, place)
            last = path.interval_before(stop)
            ends = is_same_time(last.end, stop)
            following = path.interval_at(stop) if ends and stop < total - SAME_TIME else None
            spans.append(HorizonPhase(segment, interval, t, steps, ends, following))
            t = stop
    return spans


def covers(motion: Motion, spans: list[HorizonPhase]) -> bool:
    """Return whether a horizon covers a motion, or at least one cycle of an endless one."""
    length = sum(phase.duration for piece in motion.pieces for phase in piece.phases)
    return spans[0].start < SAME_TIME and spans[-1].end > length - SAME_TIME


def check_phase_ends(span: HorizonPhase, intervals: list[PlacedPhase]) -> None:
    """Raise if a motion phase with a reset or ``until`` ends inside a part of the horizon, not at its last node."""
    for interval in intervals:
        phase, inside = interval.phase, span.start + SAME_TIME < interval.end < span.end - SAME_TIME
        if inside and (phase.reset is not None or phase.until):
            what = "reset" if phase.reset is not None else "until"
            name = span.model.name
            raise ProblemError(
                f"phase '{phase.name}' ({phase.source}): its end is inside a phase of model '{name}' - got a {what} at "
                f"{interval.end:g} s, while '{name}' covers {span.start:g} to {span.end:g} s, "
                "expected none there; remove it, or schedule another model at the phase's end"
            )
