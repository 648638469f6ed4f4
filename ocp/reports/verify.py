"""Verification: what a trajectory misses, recomputed from its states and controls alone, node by node.

Only the compiled functions and NumPy are used, none of a solver's evaluation: one linear solve for z per node, the
discrete step, the reset maps, and the rows of every equality and inequality.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError

from ..compiler import CompiledPhase, CompiledProblem, LoweredMode
from ..language import Quantity, Trajectory

Array = NDArray[np.float64]
Kind = Literal["defect", "equality", "inequality"]

BOUNDS: dict[Kind, float] = {"defect": 1e-4, "equality": 1e-3, "inequality": 1e-3}
"""What a solution may miss: defects in the tangent's units, rows in raw SI over their scale."""


@dataclass(frozen=True)
class Miss:
    """By how much one named row is missed, at its worst node.

    Args:
        kind: what kind of row.
        name: term, component and side; for a defect the component of the state.
        phase: name of the phase.
        node: node in the phase; a phase's defect 0 is that of the initial state or of the reset map before it.
        amount: raw SI amount divided by the row's scale; not finite counts as infinite.
        unit: unit of the raw amount.
        source: where the term was declared.
    """

    kind: Kind
    name: str
    phase: str
    node: int
    amount: float
    unit: str
    source: str = ""

    @property
    def ratio(self) -> float:
        """The amount relative to what ``BOUNDS`` allows."""
        return self.amount / BOUNDS[self.kind]


@dataclass(frozen=True)
class Verification:
    """What a trajectory misses.

    Args:
        misses: the worst node of every named row, worst first within each kind.
    """

    misses: tuple[Miss, ...]

    def worst(self, kind: Kind | None = None) -> Miss | None:
        """Return the worst row of a kind, or of all kinds relative to their bounds; None if there are no rows."""
        found = [miss for miss in self.misses if kind in (None, miss.kind)]
        return max(found, key=lambda miss: miss.ratio, default=None)

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
    def holds(self) -> bool:
        """Whether everything is within ``BOUNDS``."""
        return all(miss.ratio <= 1.0 for miss in self.misses)


def verify(compiled: CompiledProblem, trajectory: Trajectory) -> Verification:
    """Recompute every defect, equality and inequality of a trajectory.

    Of a model without derivatives the steps are the simulator's, and only its rows are recomputed.

    Args:
        compiled: the problem that it should solve.
        trajectory: states and controls; nothing else of it is read.

    Raises:
        ProblemError: the trajectory's phases are not the problem's.
    """
    check_fits(compiled, trajectory)
    worst: dict[tuple[str, str], Miss] = {}
    for miss in _misses(compiled, trajectory):
        known = worst.get((miss.kind, miss.name))
        if known is None or miss.amount > known.amount:
            worst[miss.kind, miss.name] = miss
    return Verification(tuple(sorted(worst.values(), key=lambda miss: (miss.kind, -miss.amount))))


def check_fits(compiled: CompiledProblem, trajectory: Trajectory) -> None:
    """Raise unless a trajectory has the phases and sizes of a problem."""
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


def _misses(compiled: CompiledProblem, trajectory: Trajectory) -> Iterator[Miss]:
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
                    yield Miss("defect", f"{quantity} length", phase.name, k, _finite(off), "")
        _, g, h = (_column(value) for value in f["terminal"](part.states[n], phase.p_end))
        yield from _rows(compiled, phase, n, "terminal_g", "inequality", -g * phase.end_g_mask)
        yield from _rows(compiled, phase, n, "terminal_h", "equality", np.abs(h) * phase.end_h_mask)
        if phase.transition is not None:
            x, p, t = part.states[n], phase.p_transition, phase.transition.functions
            start = _column(t["reset"](x, solve(t["implicit"], x, p), p))


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
    named = {name.removeprefix("model."): part for name, part in mode.layout.split(p).items()}
    dynamics = model.dynamics(mode.key, x, u, z, named)
    if quantity not in dynamics.quantities:
        return None
    value = dynamics.quantities.bind(quantity).value
    if cs.depends_on(value, cs.vertcat(u, z)):
        return None
    return cs.Function("quantity", [x, p], [cs.densify(value)])


def _defects(phase: CompiledPhase, node: int, reached: Array, state: Array) -> Iterator[Miss]:
    space = phase.mode.state
    units = [block.quantity.unit for block in space.blocks for _ in block.labels]
    defects = np.abs(space.np_minus(reached, state))
    for label, unit, amount in zip(space.labels, units, defects, strict=True):
        yield Miss("defect", label, phase.name, node, _finite(amount), unit)


def _rows(
    compiled: CompiledProblem, phase: CompiledPhase, node: int, group: str, kind: Kind, amounts: Array
) -> Iterator[Miss]:
    for row, amount in zip(phase.mode.rows[group], amounts, strict=True):
        source = str(compiled.terms[row.term].source) if row.term >= 0 else ""
        yield Miss(kind, compiled.row_name(row), phase.name, node, max(_finite(amount), 0.0), row.unit, source)


def _finite(amount: float) -> float:
    return float(amount) if np.isfinite(amount) else float("inf")


def _column(value: cs.DM) -> Array:
    return np.asarray(value.full(), dtype=float).ravel()
