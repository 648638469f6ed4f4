"""Where the feet of a motion stand on a terrain: a plane per foot and stance, at the place of the reference.

A foot in the air is between two stances. Its plane goes from that of the stance it leaves to that of the stance it
reaches, with the progress of a swing, s² (3 − 2 s).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import SAME_TIME, AddedTargets, Path, PlacedPhase, Quantity, Sample, split_entries

from .foot_planes import FootSwing, foot_planes, plane_between
from .kinematics import Kinematics
from .obstacles import Plane, none_beside, planes_about, within
from .placed_ground import PlacedGround
from .quantities import base, feet, joints
from .terrain import Terrain

Array = NDArray[np.float64]

_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


_STEPS = Quantity("_feet.steps", "m", "point")  # per foot: its place, where it has last stood, and where it will
_PROGRESS = Quantity("_feet.progress")  # per foot: share of the swing; 1 if it stands; 1 if it lands


class _Swing(NamedTuple):
    """The planes of the stances before and after a time, the share of the swing between them, and whether it lands."""

    first: Plane
    last: Plane
    share: float
    lands: bool

    @property
    def plane(self) -> Plane:
        """The plane in between."""
        if self.share == 0.0:
            return self.first
        normal = (1 - self.share) * self.first[1] + self.share * self.last[1]
        return (1 - self.share) * self.first[0] + self.share * self.last[0], normal / np.linalg.norm(normal)


@dataclass
class _Stance:
    """A stance of a foot: its start and its end [s], and the plane on which it stands."""

    start: float
    end: float
    plane: Plane


class Footing(AddedTargets):
    """Adds ``feet.surfaces`` and ``feet.normals`` to the targets of a motion, see :mod:`.quantities`.

    Args:
        kinematics: the kinematics of the robot's legs.
        terrain: the ground.
        flags: function of a phase's mode that returns 1 for each foot on the ground, (nf,).
        path: the motion's targets, without these.
    """

    def __init__(
        self, kinematics: Kinematics, terrain: Terrain, flags: Callable[[Hashable], Array], path: Path
    ) -> None:
        self.kinematics, self.terrain, self._flags, self._path = kinematics, terrain, flags, path
        self._radius = kinematics.robot.foot_radius
        self._stances: list[list[_Stance]] = [[] for _ in kinematics.robot.feet]
        self._done = 0  # phases whose stances are known
        self._known = -1.0  # time until which they are [s]

    @property
    def origin(self) -> object:
        """The terrain."""
        return self.terrain

    def at(self, t: float, interval: PlacedPhase, sample: Sample) -> Sample:
        """Return the planes of all feet: those of the ground, those below them and those beside them, (9 nf,) each."""
        self._extend(interval.end)
        places, on = reference_feet(self.kinematics, sample), self._flags(interval.phase.mode)
        ground, over, beside, steps, progress = [], [], [], [], []
        for foot, place in enumerate(places):
            if on[foot]:
                plane = self._present(foot, interval).plane
                swing = _Swing(plane, plane, 0.0, False)
                below, aside = plane, none_beside(place)
            else:
                swing = self._swing(foot, t, interval)
                plane = swing.plane
                below, aside = planes_about(self.terrain, place, self._radius)
                if swing.lands:
                    below, aside = plane, within(self.terrain, place, self._radius)
            ground.append(plane)
            over.append(below)
            beside.append(aside)
            steps += [place, swing.first[0], swing.last[0]]
            progress += [swing.share, float(on[foot] > 0), float(swing.lands)]
        planes = ground + over + beside
        added = {feet.surfaces: np.concatenate([point for point, _ in planes])}
        added[feet.normals] = np.concatenate([normal for _, normal in planes])
        added |= {_STEPS: np.concatenate(steps), _PROGRESS: np.array(progress)}
        if feet.height in sample:  # a reference measures it from level ground
            own = zip(places, ground, strict=True)
            added[feet.height] = np.array([normal @ (place - point) - self._radius for place, (point, normal) in own])
        return added

    @property
    def kept(self) -> tuple[tuple[Quantity, int], ...]:
        """Where each foot is, has stood and will stand; and how far it is on the way."""
        count = len(self.kinematics.robot.feet)
        return (_STEPS, 9 * count), (_PROGRESS, 3 * count)

    def placed(self, entries: tuple[tuple[Quantity, int], ...]) -> cs.Function:
        """Return the function that takes the planes where the steps are in the world.

        The heights of the other targets go with them: that of a foot with its plane, that of the base with the mean.
        """
        s, anchor = cs.SX.sym("s", sum(size for _, size in entries)), cs.SX.sym("anchor", 3)
        values, ground = split_entries(s, entries), PlacedGround(self.terrain, self._radius, anchor)
        swings, rises = [], []
        for steps, progress in zip(cs.vertsplit(values[_STEPS], 9), cs.vertsplit(values[_PROGRESS], 3), strict=True):
            declared = FootSwing(*cs.vertsplit(steps, 3), *cs.vertsplit(progress))
            between = declared.first[2] + declared.share * (declared.last[2] - declared.first[2])
            rises.append(plane_between(declared, ground)[0][2] - between)
            swings.append(declared._replace(place=declared.place + cs.vertcat(0, 0, rises[-1])))
        found = foot_planes(swings, ground)
        if base.position in values:
            found[base.position] = values[base.position] + cs.vertcat(0, 0, sum(rises) / len(rises))
        if feet.position in values:
            found[feet.position] = values[feet.position] + cs.vertcat(*(cs.vertcat(0, 0, rise) for rise in rises))
        moved = cs.vertcat(*(found.get(quantity, value) for quantity, value in values.items()))
        return cs.Function("placed", [s, anchor], [cs.densify(moved)], {"cse": True})

    # ---- stances

    def _present(self, foot: int, interval: PlacedPhase) -> _Stance:
        """Return the stance of a foot that is on the ground in a phase."""
        return next(each for each in reversed(self._stances[foot]) if each.start <= interval.start + SAME_TIME)

    def _swing(self, foot: int, t: float, interval: PlacedPhase) -> _Swing:
        """Return the stances around a foot in the air."""
        before = [each for each in self._stances[foot] if each.end <= interval.start + SAME_TIME]
        lift, first = (before[-1].end, before[-1].plane) if before else (0.0, self._below(foot, 0.0))
        after = self._next(foot, interval)
        if after is not None:
            land, last = after.start, after.plane
        elif np.isfinite(self._path.duration):
            land, last = self._path.duration, self._below(foot, self._path.duration)
        else:
            return _Swing(first, first, 0.0, False)
        s = min(max((t - lift) / max(land - lift, SAME_TIME), 0.0), 1.0)
        return _Swing(first, last, s**2 * (3 - 2 * s), after is not None and abs(t - land) <= SAME_TIME)

    def _next(self, foot: int, interval: PlacedPhase) -> _Stance | None:
        """Return the first stance of a foot after a phase; None if there is none, or none in the next two cycles."""
        until = interval.end
        limit = until + 2 * sum(phase.duration for piece in self._path.pieces for phase in piece.phases)
        while True:
            self._extend(until)
            for each in self._stances[foot]:
                if each.start >= interval.end - SAME_TIME:
                    return each
            if until > min(limit, self._path.duration):
                return None
            until = self._known + 2 * SAME_TIME

    def _extend(self, until: float) -> None:
        """Find the stances that begin before a time, or at it."""
        if until + SAME_TIME <= self._known:
            return
        for placed in self._path.intervals(until + 2 * SAME_TIME)[self._done :]:
            for foot, on in enumerate(self._flags(placed.phase.mode)):
                known = self._stances[foot]
                if known and known[-1].end >= placed.end:
                    continue  # it was found before an interrupt
                if on and known and abs(known[-1].end - placed.start) <= SAME_TIME:
                    known[-1].end = placed.end
                elif on:
                    known.append(_Stance(placed.start, placed.end, self._below(foot, placed.start, placed)))
            self._done += 1
            self._known = placed.end
        self._known = max(self._known, min(until, self._path.duration))

    def _below(self, foot: int, t: float, interval: PlacedPhase | None = None) -> Plane:
        """Return the plane below the reference of a foot."""
        if interval is None:
            interval = self._path.interval_at(0.0) if t == 0.0 else self._path.interval_before(t)
        place = reference_feet(self.kinematics, self._path.sample(t, interval))[foot]
        points, normals = self.terrain.surface(place[None, :2])
        return points[0], normals[0]


def reference_feet(kinematics: Kinematics, sample: Sample) -> Array:
    """Return the positions of the feet in a sample, (nf, 3) [m]: its own, or those of its base and joints."""
    if feet.position in sample:
        return np.asarray(sample[feet.position], dtype=float).reshape(-1, 3)
    angles = np.asarray(sample[joints.position]) if joints.position in sample else kinematics.robot.pose("stand")
    position = np.asarray(sample.get(base.position, np.zeros(3)), dtype=float)
    return kinematics.world_feet(position, np.asarray(sample.get(base.orientation, _UPRIGHT), dtype=float), angles)
