"""Warnings about constraints that no state meets together, and about the same constraint twice.

Rows are compared by their values at random states and controls. Two rows of one expression change in proportion, so the
distance between their bounds is the same everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..compiler import CompiledPhase, CompiledProblem, Row
from ..language import Constraint, ParameterKey, ProblemWarning

Array = NDArray[np.float64]

_SAMPLES = 6
_ALIKE = 1 - 1e-10  # cosine between the changes of two rows of one expression
_GAP = 1e-6  # a smaller distance between bounds is rounding, in units of a row's scale


def same_twice(compiled: CompiledProblem) -> Iterator[ProblemWarning]:
    """Yield constraints that are declared twice for the same phases, with the same or with other numbers."""
    constraints = [(k, term) for k, term in enumerate(compiled.terms) if isinstance(term, Constraint)]
    for (i, first), (j, second) in combinations(constraints, 2):
        alike = all(getattr(first, name) == getattr(second, name) for name in ("function", "kind", "at", "mask"))
        if alike and _sides(first) & _sides(second) and _where(compiled, i) == _where(compiled, j):
            numbers = [_numbers(compiled, k) for k in (i, j)]
            got = f" with {numbers[0]} and {numbers[1]}" if all(numbers) else ""
            yield ProblemWarning(
                second.where,
                f"the constraint is declared twice - got it{got} here and at {first.source}, expected one; both hold: "
                "remove one",
                second.source,
            )


def _sides(term: Constraint) -> set[str]:
    return {"both"} if term.kind == "equality" else {s for s in ("lower", "upper") if getattr(term, s) is not None}


def _where(compiled: CompiledProblem, k: int) -> list[bytes]:
    """Return the nodes at which a term has an effect, in a form that can be compared."""
    return [phase.applies[:, k].tobytes() for phase in compiled.phases]


def _numbers(compiled: CompiledProblem, k: int) -> str:
    """Return the numbers of a constraint as text."""
    term = compiled.terms[k]
    assert isinstance(term, Constraint)
    given = {**{s: getattr(term, s) for s in ("lower", "upper")}, **term.parameters}
    shown = {n: v for n, v in given.items() if v is not None and not callable(v) and np.size(v) == 1}
    return ", ".join(f"{n} {float(np.ravel(v)[0]):g}" for n, v in shown.items())


def contradictions(compiled: CompiledProblem) -> Iterator[ProblemWarning]:
    """Yield pairs of constraints of which no state and control meets both, and constant rows that are violated."""
    seen: set[tuple[int, ...]] = set()
    alike: dict[
        tuple[object, ...], CompiledPhase
    ] = {}  # one phase of each mode, of each set of active rows and of bounds that vary is enough
    varying = [key for key in compiled.changing if key.is_bound]
    for phase in compiled.phases:
        masks = (phase.g_mask[0], phase.h_mask[0], phase.end_g_mask, phase.end_h_mask)
        bounds = _bounds(phase, varying)
        alike.setdefault((phase.mode, bounds.tobytes(), *(mask.tobytes() for mask in masks)), phase)
    for phase in alike.values():
        for rows, values, equal, node in _tables(phase, _bounds(phase, varying)):
            change = values[1:] - values[0]
            size = np.linalg.norm(change, axis=0)
            for i in map(int, np.flatnonzero(size == 0)):
                missed = abs(values[0, i]) if equal[i] else -values[0, i]
                if missed > _GAP and rows[i].term >= 0 and (rows[i].term,) not in seen:
                    seen.add((rows[i].term,))
                    yield _constant(compiled, phase, rows[i], missed, node)
            moving = np.flatnonzero(size > 0)
            unit, level = change[:, moving] / size[moving], values[0, moving] / size[moving]
            cosine = unit.T @ unit
            for a, b in zip(*np.nonzero(np.triu(np.abs(cosine) > _ALIKE, 1)), strict=True):
                i, j = int(moving[a]), int(moving[b])
                gap = _gap(level[a], level[b], float(np.sign(cosine[a, b])), bool(equal[i]), bool(equal[j]))
                pair = (rows[i].term, rows[j].term)
                if gap * size[i] > _GAP and pair not in seen and max(pair) >= 0 and pair[0] != pair[1]:
                    seen.add(pair)
                    last, other = (j, i) if rows[j].term > rows[i].term else (i, j)
                    yield _both(compiled, phase, rows[last], rows[other], gap * size[last], node)


def _gap(first: float, second: float, sign: float, first_equal: bool, second_equal: bool) -> float:
    """Return the distance between the values that two rows of one expression allow; 0 if a value meets both.

    Both rows are divided by the size of their change: the first is e + first, the second sign · e + second, with a
    common expression e. An inequality must be ≥ 0, an equality 0.
    """
    if first_equal and second_equal:
        return abs(second - sign * first)
    if first_equal:
        return max(sign * first - second, 0.0)
    if second_equal:
        return max(sign * second - first, 0.0)
    return max(-(first + second), 0.0) if sign < 0 else 0.0


def _bounds(phase: CompiledPhase, varying: Sequence[ParameterKey]) -> Array:
    """Return the bounds of a phase's stages that vary over phases, and which of them are finite, (n, size)."""
    slices = phase.mode.layout.slices
    parts = [slices[key] for bound in varying for key in (bound, bound.has_bound) if key in slices]
    return np.hstack([np.zeros((len(phase.p), 0)), *(phase.p[:, part] for part in parts)])


def _tables(phase: CompiledPhase, bounds: Array) -> Iterator[tuple[list[Row], Array, NDArray[np.bool_], int]]:
    """Yield active rows, their values at random points (points, rows), whether they are equalities, and the node.

    Of the stages, those are taken whose bounds (n, size) differ from the ones before.
    """
    rng, mode = np.random.default_rng(0), phase.mode
    stages = [k for k in range(len(phase.p)) if k == 0 or np.any(bounds[k] != bounds[k - 1])]
    for group, x, p, masks, node in (
        *(("stage", phase.guess_states[k], phase.p[k], {"g": phase.g_mask[k], "h": phase.h_mask[k]}, k)
          for k in stages),
        ("terminal", phase.guess_states[-1], phase.p_end, {"g": phase.end_g_mask, "h": phase.end_h_mask},
         phase.num_stages),
    ):  # fmt: skip
        kept = {kind: np.flatnonzero(masks[kind][: len(mode.rows[f"{group}_{kind}"])]) for kind in ("g", "h")}
        if sum(map(len, kept.values())) < 1:
            continue
        points = []
        for _ in range(_SAMPLES):
            state = mode.state.np_plus(x, 0.3 * rng.standard_normal(mode.state.ndx))
            more = [rng.standard_normal(mode.nu), rng.standard_normal(mode.nz)] if group == "stage" else []
            values: Mapping[str, Array] = _call(mode.functions[group], state, *more, p)
            points.append(np.concatenate([values[kind][kept[kind]] for kind in ("g", "h")]))
        rows = [mode.rows[f"{group}_{kind}"][i] for kind in ("g", "h") for i in kept[kind]]
        table = np.array(points)
        usable = np.all(np.isfinite(table), axis=0)
        equal = np.repeat([False, True], [len(kept["g"]), len(kept["h"])])
        yield [row for row, use in zip(rows, usable, strict=True) if use], table[:, usable], equal[usable], node


def _call(function: object, *arguments: Array) -> dict[str, Array]:
    names = function.name_out()  # type: ignore[attr-defined]  # a CasADi function
    return {n: v.full().ravel() for n, v in zip(names, function.call(list(arguments)), strict=True)}  # type: ignore[attr-defined]  # the same


def _both(
    compiled: CompiledProblem, phase: CompiledPhase, later: Row, earlier: Row, gap: float, node: int
) -> ProblemWarning:
    term = compiled.terms[later.term]
    other = (
        f" ({compiled.terms[earlier.term].source})" if earlier.term >= 0 else ", which the next phase's contacts need"
    )
    return ProblemWarning(
        f"{term.where}, phase '{phase.name}', node {node}",
        f"two rows exclude each other - got '{compiled.row_name(later)}' and '{compiled.row_name(earlier)}'{other}, "
        f"{gap * later.scale:.3g} {later.unit}".rstrip()
        + " apart, expected bounds that one state meets; change one of "
        "them, or restrict it with when=",
        term.source,
    )


def _constant(compiled: CompiledProblem, phase: CompiledPhase, row: Row, missed: float, node: int) -> ProblemWarning:
    term = compiled.terms[row.term]
    return ProblemWarning(
        f"{term.where}, phase '{phase.name}', node {node}",
        f"row '{compiled.row_name(row)}' depends on neither state nor control and is violated - got "
        f"{missed * row.scale:.3g} {row.unit}".rstrip()
        + ", expected an expression of the node's quantities; correct it",
        term.source,
    )
