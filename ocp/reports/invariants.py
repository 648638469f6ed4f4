"""How far a trajectory departs from the invariants of its models, see :mod:`piaffe.ocp.language.invariants`.

For a point in contact from node a on, at a later node k, and for one that falls from node a on::

    slip = |p_k − p_a|,    height = |gap_k|,    flight = |p_k − (p_a + v_a (t_k − t_a) + ½ g (t_k − t_a)²)|
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from ..compiler import CompiledPhase, CompiledProblem, LoweredMode, bound_invariants
from ..language import Invariants, Trajectory
from .violation import Violation, finite

Array = NDArray[np.float64]


class _Nodes(NamedTuple):
    """Values of the invariants of a phase, at its nodes (N + 1, …) and, flags and gravity, at its stages (N, …)."""

    contacts: tuple[str, ...]
    ballistic: tuple[str, ...]
    rests: Array
    place: Array
    height: Array
    falls: Array
    position: Array
    velocity: Array
    gravity: Array


def invariant_violations(compiled: CompiledProblem, trajectory: Trajectory) -> Iterator[Violation]:
    """Yield slip, height and flight of every such point at every node; a stretch may span several phases."""
    functions: dict[LoweredMode, tuple[Invariants, cs.Function]] = {}
    held: dict[str, Array] = {}
    thrown: dict[str, tuple[float, Array, Array]] = {}
    before: CompiledPhase | None = None
    for phase, part in zip(compiled.phases, trajectory.phases, strict=True):
        if phase.mode not in functions:
            functions[phase.mode] = _functions(phase.mode)
        nodes = _evaluate(*functions[phase.mode], part.states, np.vstack([phase.p, phase.p_end]))
        if before is not None and _jumps(before, phase):
            held, thrown = {}, {}
        before = phase
        yield from _rest(phase, nodes, held)
        yield from _fall(phase, nodes, thrown)


def _rest(phase: CompiledPhase, nodes: _Nodes, held: dict[str, Array]) -> Iterator[Violation]:
    """Yield slip and height of the points in contact; ``held`` has where each was first, and is kept up to date."""
    for j, name in enumerate(nodes.contacts):
        for k in range(phase.num_stages):
            if not nodes.rests[k, j]:
                held.pop(name, None)
                continue
            start = held.setdefault(name, nodes.place[k, j])
            for node in (k, k + 1):
                slip = float(np.linalg.norm(nodes.place[node, j] - start))
                yield Violation(f"{name} slip", phase.name, node, finite(slip), "m", "slip")
                yield Violation(
                    f"{name} height", phase.name, node, finite(abs(float(nodes.height[node, j]))), "m", "height"
                )


def _fall(phase: CompiledPhase, nodes: _Nodes, thrown: dict[str, tuple[float, Array, Array]]) -> Iterator[Violation]:
    """Yield the departures from parabolas; ``thrown`` has when, where and how fast each flight began."""
    for j, name in enumerate(nodes.ballistic):
        for k in range(phase.num_stages):
            if not nodes.falls[k, j]:
                thrown.pop(name, None)
                continue
            begin = (float(phase.times[k]), nodes.position[k, j], nodes.velocity[k, j])
            t, position, velocity = thrown.setdefault(name, begin)
            since = float(phase.times[k + 1]) - t
            expected = position + velocity * since + 0.5 * nodes.gravity[k, j] * since**2
            off = float(np.linalg.norm(nodes.position[k + 1, j] - expected))
            yield Violation(f"{name} off its parabola", phase.name, k + 1, finite(off), "m", "flight")


def _jumps(before: CompiledPhase, phase: CompiledPhase) -> bool:
    """Return whether positions may change between two phases: another model, or a reset that the user declared."""
    user = before.ends_phase and before.interval.phase.reset is not None
    return user or before.mode.model is not phase.mode.model


def _functions(mode: LoweredMode) -> tuple[Invariants, cs.Function]:
    """Return the invariants of a mode, and (x, p) → their values as one column each."""
    x, p, invariants = bound_invariants(mode)
    rests, falls = invariants.contacts, invariants.ballistic
    groups = [
        [each.flag for each in rests], [each.position for each in rests], [each.height for each in rests],
        [each.flag for each in falls], [each.position for each in falls], [each.velocity for each in falls],
        [each.gravity for each in falls],
    ]  # fmt: skip
    values = [cs.densify(cs.vertcat(*group)) if group else cs.SX(0, 1) for group in groups]
    return invariants, cs.Function("invariants", [x, p], values)


def _evaluate(invariants: Invariants, function: cs.Function, states: Array, p: Array) -> _Nodes:
    """Return the values of the invariants at the nodes of a phase."""
    table = [[value.full().ravel() for value in function(x, row)] for x, row in zip(states, p, strict=True)]
    flags, place, height, falls, position, velocity, gravity = (np.array(column) for column in zip(*table, strict=True))
    place = place.reshape(len(states), len(invariants.contacts), 3)
    position, velocity, gravity = (
        each.reshape(len(states), len(invariants.ballistic), 3) for each in (position, velocity, gravity)
    )
    return _Nodes(
        tuple(each.name for each in invariants.contacts), tuple(each.name for each in invariants.ballistic),
        flags, place, height, falls, position, velocity, gravity,
    )  # fmt: skip
