"""Falls: the phases in which a point falls freely until feet land, and the height at which they should land."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from ..compiler.compile import RUNNING, Compilation
from ..compiler.guess import guess_states
from ..compiler.invariants import bound_invariants
from ..compiler.mode import LoweredMode
from ..compiler.timeline import HorizonPhase
from ..language import Sample
from .calendar import Calendar

Array = NDArray[np.float64]


class Falls:
    """The flights of a motion that end with a landing, for the first model of a schedule.

    The falling point is the first ``BallisticPoint`` of the model's invariants, for a robot its centre of mass. Its
    height is along the direction against gravity.

    Args:
        compilation: the compiler at work on the problem.
        calendar: the phases.
        samples: per entry of the calendar, the samples of the declared path at its ticks.

    Attributes:
        heights: per entry, the height of the point at the end of the phase on the declared path [m]; NaN for phases in
            which nothing falls, or that do not end with a landing.
        follows: whether the height goes with the world, as that of a landing on a terrain: it is then that of the
            sample at the phase's end, and not the declared one.
        functions: per mode of these entries (x, p) → height [m], vertical speed [m/s], gravity [m/s²]; (3,).
    """

    def __init__(self, compilation: Compilation, calendar: Calendar, samples: Sequence[Sequence[Sample]]) -> None:
        self.heights: Array = np.full(len(calendar.entries), np.nan)
        self.functions: dict[LoweredMode, cs.Function] = {}
        segment = compilation.problem.schedule.segments[0]
        self.follows = bool(compilation.path.added)
        if not compilation.head.cut_by_modes:
            return
        known: dict[LoweredMode, tuple[cs.Function, cs.Function] | None] = {}
        for e, entry in enumerate(calendar.entries):
            after = calendar.following[e]
            if after < 0 or entry.phase.reset is not None:
                continue
            span = HorizonPhase(segment, entry.placed, entry.placed.start, 1, True, calendar.entries[after].placed)
            mode, last = compilation.mode(span), samples[e][-1]
            node = compilation.node(span, entry.placed.end, entry.placed, last, is_end=True)
            if mode not in known:
                known[mode] = fall_functions(mode)
            found = known[mode]
            if found is None or not mode.model.lands(node):
                continue
            flag, fall = found
            p = compilation.numbers.of_nodes(mode, segment.dt, [node], entry.phase, RUNNING)[0]
            if float(flag(p)) == 1.0:
                self.functions[mode] = fall
                x = guess_states(mode.model, [last], compilation.start)[0]
                self.heights[e] = float(fall(x, p)[0])


def fall_functions(mode: LoweredMode) -> tuple[cs.Function, cs.Function] | None:
    """Return p → flag of the falling point of a mode, and (x, p) → its height, speed and gravity; None without one."""
    x, p, invariants = bound_invariants(mode)
    falls = invariants.ballistic
    if not falls:
        return None
    point = falls[0]
    gravity = cs.norm_2(point.gravity)
    up = -point.gravity / gravity
    values = cs.densify(cs.vertcat(cs.dot(up, point.position), cs.dot(up, point.velocity), gravity))
    return cs.Function("flag", [p], [point.flag]), cs.Function("fall", [x, p], [values], {"cse": True})
