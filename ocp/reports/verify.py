"""Verification: the violations of a trajectory, recomputed only from its states and controls, node by node.

It uses the compiled functions and NumPy, and no code of a solver: one linear solve for z per node, the discrete step,
the reset maps, the rows of every equality and inequality, and the invariants of models over many steps: feet on the
ground stay where they are, and in flight the centre of mass follows its parabola.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError, renamed_members

from ..compiler import CompiledPhase, CompiledProblem, LoweredMode, Row
from ..language import Quantity, Trajectory
from .invariants import invariant_violations
from .violation import Kind, Violation, finite

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Verification:
    """The violations of the rows of a problem, and of the invariants of its models, by a trajectory.

    Args:
        violations: the worst node of every named row, also of rows that hold; the worst first within each kind.
    """

    violations: tuple[Violation, ...]

    def worst(self, kind: Kind | None = None) -> Violation | None:
        """Return the worst row of a kind, or of all kinds relative to their bounds; None if there are no rows."""
        found = [each for each in self.violations if kind in (None, each.kind)]
        return max(found, key=lambda each: each.ratio, default=None)

    def largest(self, kind: Kind) -> float:
        """Return the largest amount of a kind, 0 if it has no rows."""
        worst = self.worst(kind)
        return worst.amount if worst else 0.0

    @property
    def max_defect(self) -> float:
        """Largest defect, ∞-norm in the tangent; initial state, reset maps and the length of quaternions included."""
        return self.largest("defect")

    @property
    def max_equality(self) -> float:
        """Largest |h| over its scale."""
        return self.largest("equality")

    @property
    def max_inequality(self) -> float:
        """Largest −g over its scale, 0 if all hold."""
        return self.largest("inequality")

    @property
    def max_slip(self) -> float:
        """Largest distance of a resting foot from where it was at the start of its stance [m], 0 without feet."""
        return self.largest("slip")

    @property
    def max_height(self) -> float:
        """Largest distance of a resting foot from the ground, above or below [m], 0 without feet."""
        return self.largest("height")

    @property
    def max_flight(self) -> float:
        """Largest distance of the centre of mass from its parabola, over every flight [m], 0 without flight."""
        return self.largest("flight")

    @property
    def holds(self) -> bool:
        """Whether every violation is within ``BOUNDS``."""
        return all(each.ratio <= 1.0 for each in self.violations)

    if not TYPE_CHECKING:  # mypy still reports the old names as unknown
        __getattr__ = renamed_members("Verification", {"misses": "violations"})


def verify(compiled: CompiledProblem, trajectory: Trajectory) -> Verification:
    """Recompute every defect, equality and inequality of a trajectory, and the invariants of its models.

    For a model without derivatives only the rows are recomputed, because the simulator makes its steps.

    Args:
        compiled: the problem of the trajectory.
        trajectory: the trajectory; only its states and controls are used.

    Raises:
        ProblemError: the trajectory's phases are not the problem's.
    """
    check_fits(compiled, trajectory)
    worst: dict[tuple[str, str], Violation] = {}
    for found in chain(_violations(compiled, trajectory), invariant_violations(compiled, trajectory)):
        known = worst.get((found.kind, found.name))
        if known is None or found.amount > known.amount:
            worst[found.kind, found.name] = found
    return Verification(tuple(sorted(worst.values(), key=lambda found: (found.kind, -found.amount))))


def check_fits(compiled: CompiledProblem, trajectory: Trajectory) -> None:
    """Raise if a trajectory has other phases or sizes than a problem."""
    expected = [(p.name, p.num_stages, p.mode.state.nx, p.mode.nu) for p in compiled.phases]
    got = [(p.name, len(p.controls), p.states.shape[1], p.controls.shape[1]) for p in trajectory.phases]
    for i, (one, other) in enumerate(zip(expected, got, strict=False)):
        if one != other:
            raise ProblemError(
                f"trajectory, phase {i}: is not of this problem - got (name, stages, nx, nu) = {other}, expected "
                f"{one}; pass the problem that it was solved for"
            )
    if len(expected) != len(got):
        raise ProblemError(
            f"trajectory: is not of this problem - got {len(got)} phases, expected {len(expected)}; pass the problem "
            "that it was solved for"
        )


def _violations(compiled: CompiledProblem, trajectory: Trajectory) -> Iterator[Violation]:
    start = compiled.initial
    for phase, part in zip(compiled.phases, trajectory.phases, strict=True):
        f, space, n = phase.mode.functions, phase.mode.state, phase.num_stages
        yield from _defects(phase, 0, start, part.states[0])
        for k in range(n):
            x, u, p = part.states[k], part.controls[k], phase.p[k]
            if phase.mode.model.has_derivatives:
                z = solve(f["implicit"], x, u, p)
                x_next, _, g, h = (_column(value) for value in f["stage"](x, u, z, p))
                yield from _defects(phase, k + 1, x_next, part.states[k + 1])
            else:
                _, g, h = (_column(value) for value in f["stage"](x, u, np.zeros(phase.mode.nz), p))
            yield from _rows(compiled, phase, k, "stage_g", "inequality", -g * phase.g_mask[k])
            yield from _rows(compiled, phase, k, "stage_h", "equality", np.abs(h) * phase.h_mask[k])
        for k, x in enumerate(part.states):
            for quantity, where in space.slices.items():
                if quantity.kind == "rotation":
                    off = abs(float(np.linalg.norm(x[where])) - 1.0)
                    yield Violation(f"{quantity} length", phase.name, k, finite(off), "", "defect")
        _, g, h = (_column(value) for value in f["terminal"](part.states[n], phase.p_end))
        yield from _rows(compiled, phase, n, "terminal_g", "inequality", -g * phase.end_g_mask[: len(g)])
        yield from _rows(compiled, phase, n, "terminal_h", "equality", np.abs(h) * phase.end_h_mask[: len(h)])
        if phase.transition is not None:
            x, p, t = part.states[n], phase.p_transition, phase.transition.functions
            z = solve(t["implicit"], x, p)
            start = _column(t["reset"](x, z, p))
            yield from _reset_rows(compiled, phase, [_column(value) for value in t["rows"](x, z, p)])


def solve(implicit: cs.Function, *arguments: Array) -> Array:
    """Return z = −K⁻¹ r0 at one node, (nz,); infinite where K is singular."""
    K, r0 = (value.full() for value in implicit(*arguments))
    if r0.size == 0:
        return np.zeros(0)
    try:
        return -np.linalg.solve(K, r0.ravel())
    except np.linalg.LinAlgError:
        return np.full(r0.size, np.inf)


def quantity_values(compiled: CompiledProblem, trajectory: Trajectory, quantity: Quantity) -> list[Array | None]:
    """Return a quantity of the state at every node, (N+1, size) per phase; None where the model cannot supply it."""
    check_fits(compiled, trajectory)
    out: list[Array | None] = []
    for phase, part in zip(compiled.phases, trajectory.phases, strict=True):
        function = quantity_function(phase.mode, quantity)
        if function is None:
            out.append(None)
            continue
        numbers = [*phase.p, phase.p_end]
        out.append(np.array([_column(function(x, p)) for x, p in zip(part.states, numbers, strict=True)]))
    return out


def quantity_function(mode: LoweredMode, quantity: Quantity) -> cs.Function | None:
    """Return (x, p) → value of a quantity of the state, or None if the model cannot supply it."""
    model = mode.model
    x, u, z = (
        cs.SX.sym(name, size)
        for name, size in (("x", model.state.nx), ("u", model.control.nx), ("z", model.implicit_size(mode.key)))
    )
    p = cs.SX.sym("p", mode.layout.size)
    dynamics = model.dynamics(mode.key, x, u, z, mode.layout.of_model(p))
    if quantity not in dynamics.quantities:
        return None
    value = dynamics.quantities.bind(quantity).value
    if cs.depends_on(value, cs.vertcat(u, z)):
        return None
    return cs.Function("quantity", [x, p], [cs.densify(value)])


def _defects(phase: CompiledPhase, node: int, reached: Array, state: Array) -> Iterator[Violation]:
    space = phase.mode.state
    units = [block.quantity.unit for block in space.blocks for _ in block.labels]
    defects = np.abs(space.np_minus(reached, state))
    for label, unit, amount in zip(space.labels, units, defects, strict=True):
        yield Violation(label, phase.name, node, finite(amount), unit, "defect")


def _rows(
    compiled: CompiledProblem, phase: CompiledPhase, node: int, group: str, kind: Kind, amounts: Array
) -> Iterator[Violation]:
    yield from _amounts(compiled, phase, node, phase.mode.rows[group], kind, amounts)


def _reset_rows(compiled: CompiledProblem, phase: CompiledPhase, rows: list[Array]) -> Iterator[Violation]:
    """Yield the violations of the rows on impulses after a phase; ``rows``: residual, g and h of the transition."""
    assert phase.transition is not None  # only called if there is one
    of, (_, g, h), n, own = phase.transition.rows, rows, phase.num_stages, phase.mode.rows
    g_mask, h_mask = phase.end_g_mask[len(own["terminal_g"]) :], phase.end_h_mask[len(own["terminal_h"]) :]
    yield from _amounts(compiled, phase, n, of["g"], "inequality", np.where(g_mask > 0, -g, 0.0))
    yield from _amounts(compiled, phase, n, of["h"], "equality", np.where(h_mask > 0, np.abs(h), 0.0))


def _amounts(
    compiled: CompiledProblem, phase: CompiledPhase, node: int, rows: Sequence[Row], kind: Kind, amounts: Array
) -> Iterator[Violation]:
    for row, amount in zip(rows, amounts, strict=True):
        source = str(compiled.terms[row.term].source) if row.term >= 0 else ""
        yield Violation(compiled.row_name(row), phase.name, node, max(finite(amount), 0.0), row.unit, kind, source)


def _column(value: cs.DM) -> Array:
    return np.asarray(value.full(), dtype=float).ravel()
