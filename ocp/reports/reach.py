"""Warnings about equalities at the ends of phases that no state meets.

At the end of a phase a search looks for a state that meets the equalities and the inequalities on the state there, with
the points in contact on the ground (in the motion's first phase, at their place). It is a Levenberg-Marquardt search
from the path's state and from states near it. Where the best state still misses an equality, the equality is out of
reach.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from ..compiler import CompiledPhase, CompiledProblem, LoweredMode, bound_invariants
from ..language import ProblemWarning

Array = NDArray[np.float64]

_MISSED = 1e-2  # a smaller distance is reached, in units of a row's scale
_STEPS = 60
_STARTS = 3


@dataclass(frozen=True, eq=False)
class _EndOfMode:
    """Functions of a mode's last node: (x, p) → values and derivatives; and its contacts."""

    values: cs.Function
    contacts: cs.Function


@lru_cache(maxsize=16)
def _end_of(mode: LoweredMode) -> _EndOfMode:
    x, p, invariants = bound_invariants(mode)
    dx = cs.SX.sym("dx", mode.state.ndx)
    moved = mode.state.nudge(x, dx)
    points = invariants.contacts
    flags = cs.vertcat(*(point.flag for point in points)) if points else cs.SX(0, 1)
    heights = cs.vertcat(*(point.height for point in points)) if points else cs.SX(0, 1)
    places = cs.vertcat(*(point.position for point in points)) if points else cs.SX(0, 1)
    both = cs.vertcat(heights, places)
    by_x = cs.substitute(cs.jacobian(cs.substitute(both, x, moved), dx), dx, cs.DM.zeros(mode.state.ndx))
    contacts = cs.Function("contacts", [x, p], [flags, heights, places, cs.densify(by_x)])
    return _EndOfMode(mode.functions["terminal"], contacts)


def out_of_reach(compiled: CompiledProblem) -> Iterator[ProblemWarning]:
    """Yield equalities of the user at the ends of phases that no state meets, or that only a very fast motion meets."""
    held = None  # places of the points that have been in contact since the start
    for number, phase in enumerate(compiled.phases):
        if not phase.mode.model.has_derivatives:
            return
        rows = phase.mode.rows["terminal_h"]
        active = [i for i, row in enumerate(rows) if phase.end_h_mask[i] > 0]
        own = [i for i in active if rows[i].term >= 0 and compiled.terms[rows[i].term].at != "running"]
        if number == 0 and own:
            held = np.array(_end_of(phase.mode).contacts(compiled.initial, phase.p[0])[2]).ravel()
        if own and number > 0:
            held = None
        if own:
            missed, x = _least(phase, active, held)
            if missed.max() < _MISSED:
                yield from _too_fast(compiled, phase, own, x)
            for i in own:
                row, term = rows[i], compiled.terms[rows[i].term]
                if missed[active.index(i)] > _MISSED:
                    yield ProblemWarning(
                        f"{term.where}, phase '{phase.name}', node {phase.num_stages}",
                        f"it is out of reach - got {missed[active.index(i)] * row.scale:.3g} {row.unit}".rstrip()
                        + " at the nearest state that was found with the contacts on the ground, expected 0; move the "
                        "target, or end another phase with it",
                        term.source,
                    )
                    break


def _too_fast(compiled: CompiledProblem, phase: CompiledPhase, own: list[int], x: Array) -> Iterator[ProblemWarning]:
    """Yield a warning if the model's position must move faster than it can from the phase's start to the state x."""
    model = phase.mode.model
    if model.planar_pose is None or model.fastest is None:
        return
    at = phase.mode.state.slices[model.planar_pose[0]]
    time = float(phase.times[-1] - phase.times[0])
    way = float(np.linalg.norm(x[at] - phase.guess_states[0][at]))
    if way / time > model.fastest:
        term = compiled.terms[phase.mode.rows["terminal_h"][own[0]].term]
        yield ProblemWarning(
            f"{term.where}, phase '{phase.name}', node {phase.num_stages}",
            f"it is out of reach - got {way:.3g} m from the path at the phase's start to the nearest state that was "
            f"found, {way / time:.3g} m/s over {time:g} s, expected at most {model.fastest:.3g} m/s; move the target, "
            "or lengthen the phase",
            term.source,
        )


def _least(phase: CompiledPhase, active: list[int], held: Array | None) -> tuple[Array, Array]:
    """Return how far the active equalities are from zero at the best state, in units of their scales, and the state."""
    rng, state = np.random.default_rng(0), phase.mode.state
    best: tuple[Array, Array] | None = None
    for start in range(_STARTS):
        x = phase.guess_states[-1]
        if start:
            x = np.asarray(state.np_plus(x, 0.2 * rng.standard_normal(state.ndx)), dtype=np.float64)
        found = _search(phase, x, active, held)
        if best is None or found[0].max() < best[0].max():
            best = found
        if best[0].max() < _MISSED:
            break
    assert best is not None  # there is at least one start
    return best


def _search(phase: CompiledPhase, x: Array, active: list[int], held: Array | None) -> tuple[Array, Array]:
    """Return how far the active equalities are from zero at the end of a search from x, and the state there."""
    damping = 1e-3
    r, J, h = _system(phase, x, active, held)
    for _ in range(_STEPS):
        normal = J.T @ J + damping * np.eye(J.shape[1])
        step = np.asarray(np.linalg.solve(normal, -J.T @ r), dtype=np.float64)
        trial = phase.mode.state.np_plus(x, step)
        new, new_J, new_h = _system(phase, trial, active, held)
        if np.all(np.isfinite(new)) and new @ new < r @ r:
            gained = r @ r - new @ new
            x, r, J, h, damping = trial, new, new_J, new_h, max(damping / 5, 1e-9)
            if r @ r < 1e-8 or gained < 1e-9 * (r @ r):
                break
        else:
            damping *= 10
            if damping > 1e8:
                break
    return np.abs(h), x


def _system(phase: CompiledPhase, x: Array, active: list[int], held: Array | None) -> tuple[Array, Array, Array]:
    """Return residuals, their derivatives by the tangent, and the active equalities."""
    mode = phase.mode
    values = dict(zip(*_outputs(mode.functions["terminal"], x, phase.p_end), strict=True))
    slopes = dict(zip(*_outputs(mode.functions["terminal_d"], x, phase.p_end), strict=True))
    h, g = values["h"].ravel()[active], values["g"].ravel()
    count = len(mode.rows["terminal_g"])
    bad = np.flatnonzero((g < 0) & (phase.end_g_mask[:count] > 0))
    _, (flags, heights, places, by_x) = _outputs(_end_of(mode).contacts, x, phase.p_end)
    on = np.flatnonzero(flags.ravel() > 0)
    parts = [h, g[bad], 10 * heights.ravel()[on]]
    matrices = [slopes["h_x"][active], slopes["g_x"][bad], 10 * by_x[on]]
    if held is not None:
        at = [3 * int(i) + axis for i in on for axis in range(3)]
        parts.append(10 * (places.ravel() - held)[at])
        matrices.append(10 * by_x[len(flags.ravel()) + np.array(at, dtype=int)])
    return np.concatenate(parts), np.vstack(matrices), h


def _outputs(function: cs.Function, *arguments: Array) -> tuple[list[str], list[Array]]:
    return function.name_out(), [value.full() for value in function.call(list(arguments))]
