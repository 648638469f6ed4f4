"""Where a simulated policy departs from its plan: touchdowns, liftoffs, slips, collisions and torques."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .policy_run import PolicyRun

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

What = Literal["early", "late", "absent", "lifted", "stuck", "slipped", "collided", "saturated"]

_TEXT: dict[What, str] = {
    "early": "{name} touched down {ms:.0f} ms early",
    "late": "{name} touched down {ms:.0f} ms late",
    "absent": "{name} did not touch down for {ms:.0f} ms, to the end of its stance",
    "lifted": "{name} was off the ground for {ms:.0f} ms of its stance",
    "stuck": "{name} lifted off {ms:.0f} ms late",
    "slipped": "{name} slipped {mm:.0f} mm",
    "collided": "{name} touched the ground for {ms:.0f} ms",
    "saturated": "the torque of {name} was at its limit for {ms:.0f} ms",
}
_LEAST: dict[What, float] = {
    "early": 10e-3, "late": 10e-3, "absent": 10e-3, "lifted": 10e-3, "stuck": 10e-3, "slipped": 10e-3,
    "collided": 1e-3, "saturated": 20e-3,
}  # fmt: skip
"""Smaller deviations are not reported [s]; slips [m]."""


@dataclass(frozen=True)
class Deviation:
    """One departure of a simulation from its plan.

    Args:
        what: ``"early"``, ``"late"`` or ``"absent"`` touchdown, ``"lifted"`` in a stance, ``"stuck"`` to the ground
            after it, ``"slipped"``; a part that is no foot ``"collided"`` with the ground, a torque was
            ``"saturated"``.
        name: the foot, the part or the joint.
        time: when it began [s].
        phase: name of the plan's phase at that time.
        amount: how long [s]; of a slip how far [m].
    """

    what: What
    name: str
    time: float
    phase: str
    amount: float

    @property
    def size(self) -> float:
        """The amount relative to the smallest one that is reported."""
        return self.amount / _LEAST[self.what]

    def __str__(self) -> str:
        return _TEXT[self.what].format(name=self.name, ms=1e3 * self.amount, mm=1e3 * self.amount)


def deviations(
    run: PolicyRun,
    stances: Flags,
    phases: Sequence[str],
    feet: Sequence[str],
    joints: Sequence[str],
    least_force: float,
) -> tuple[Deviation, ...]:
    """Return the departures of a run from its plan, in the order of time.

    Args:
        run: the run, with T steps.
        stances: whether each foot is on the ground in the plan, (T, nf).
        phases: names of the plan's phases.
        feet: names of the feet.
        joints: names of the joints.
        least_force: a foot with at least this normal force is on the ground [N].
    """
    found = [*_of_feet(run, stances, feet, least_force), *_collisions(run), *_saturations(run, joints)]
    return tuple(
        Deviation(what, name, float(run.times[i]), phases[run.phases[i]], float(amount))
        for what, name, i, amount in sorted(found, key=lambda each: each[2])
        if amount >= _LEAST[what] - 1e-9
    )


_Found = tuple[What, str, int, float]


def _of_feet(run: PolicyRun, stances: Flags, feet: Sequence[str], least_force: float) -> Iterator[_Found]:
    loaded, dt = run.forces[:, :, 2] >= least_force, _step(run)
    for j, name in enumerate(feet):
        on, rests = loaded[:, j], stances[:, j]
        stretches = list(_stretches(rests))
        for i, (first, last) in enumerate(stretches):
            lands = rests[first] and first > 0
            if rests[first]:
                yield from _in_stance(name, on, first, last, dt, lands)
            else:
                yield from _in_swing(name, on, first, last, dt, ends=i + 1 < len(stretches))
            slips = np.cumsum(run.slips[first:last, j] * on[first:last])
            if len(slips):
                begin = int(np.argmax(slips >= _LEAST["slipped"]))
                yield "slipped", name, first + begin, float(slips[-1])


def _in_stance(name: str, on: Flags, first: int, last: int, dt: float, lands: bool) -> Iterator[_Found]:
    """Yield a late or an absent touchdown of a stance, and the longest time off the ground after it."""
    touches = np.flatnonzero(on[first:last])
    if not len(touches):
        yield "absent", name, first, (last - first) * dt
        return
    start = first + int(touches[0]) if lands else first
    if start > first:
        yield "late", name, first, (start - first) * dt
    off = [(b - a, start + a) for a, b in _stretches(on[start:last]) if not on[start + a]]
    if off:
        length, begin = max(off)
        yield "lifted", name, begin, length * dt


def _in_swing(name: str, on: Flags, first: int, last: int, dt: float, ends: bool) -> Iterator[_Found]:
    """Yield a late liftoff and an early touchdown of a swing."""
    off = np.flatnonzero(~on[first:last])
    left = first + int(off[0]) if len(off) else last
    if first > 0 and left > first:
        yield "stuck", name, first, (left - first) * dt
    touches = np.flatnonzero(on[left:last])
    if len(touches):
        at = left + int(touches[0])
        yield ("early" if ends else "stuck"), name, at, (last - at) * dt


def _collisions(run: PolicyRun) -> Iterator[_Found]:
    for name in sorted({name for names in run.touching for name in names}):
        hits = np.array([name in names for names in run.touching])
        yield "collided", name.removesuffix(" hull"), int(np.argmax(hits)), float(hits.sum()) * _step(run)


def _saturations(run: PolicyRun, joints: Sequence[str]) -> Iterator[_Found]:
    for j, name in enumerate(joints):
        if run.full[:, j].any():
            yield "saturated", name, int(np.argmax(run.full[:, j])), float(run.full[:, j].sum()) * _step(run)


def _stretches(flags: Flags) -> Iterator[tuple[int, int]]:
    """Yield first and last + 1 of every stretch of equal flags."""
    cuts = np.flatnonzero(np.diff(flags)) + 1
    ends = [0, *cuts.tolist(), len(flags)]
    yield from pairwise(ends)


def _step(run: PolicyRun) -> float:
    return float(run.times[1] - run.times[0]) if len(run.times) > 1 else 0.0
