"""The derivative check: every derivative of a compiled problem against central differences on the manifold.

For each mode and transition the check takes nodes of the initial guess and random states near them. A derivative J is
compared with central differences D(h) and D(h/2). These also give their own accuracy: the truncation error of D(h/2) is
about |D(h) − D(h/2)| / 3, its rounding error about ε |f| / h. |J − D(h/2)| must not exceed a small multiple of that
sum.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..compiler import (
    CompiledPhase,
    CompiledProblem,
    LoweredMode,
    LoweredTransition,
    Row,
    Vectorised,
    solve_implicit,
)
from .differences import STEP, Difference, differences_of, rate_of
from .verify import solve

Array = NDArray[np.float64]

_MARGIN = 10.0  # allowed error, in multiples of the estimated truncation error of a difference
_NOISE = 5e2  # rounding of one evaluation, in units of ε |f|
_NOISE_SOLVED = 5e4  # the same after a linear solve
_ROUGH = 1e-2  # relative truncation error above which a function counts as not smooth


@dataclass(frozen=True)
class DerivativeCheck:
    """Comparison of one block of derivatives with differences: the rows of one term by one kind of argument.

    Args:
        where: mode or transition.
        output: the function: ``"residual"``, ``"g"``, ``"h"``, ``"d"`` (the step, or reset, minus the next state) or
            ``"r"`` (the implicit part). With ``"(z)"`` at the end, the derivative is total: z is the solution of the
            implicit part.
        by: ``"x"``, ``"u"`` or ``"z"``.
        term: name of the term, or of the model.
        row: the row with the largest error in proportion to ``allowed``.
        error: |J − D| there.
        allowed: largest error that the accuracy of the differences allows there.
        rate: order of convergence of differences to J; 2 for a smooth function, None if they are exact.
        smooth: whether the differences behave like those of a smooth function.
        source: where the term was declared.
    """

    where: str
    output: str
    by: str
    term: str
    row: str
    error: float
    allowed: float
    rate: float | None
    smooth: bool
    source: str = ""

    @property
    def agrees(self) -> bool:
        """Whether the derivative agrees with the differences, within their accuracy."""
        return self.smooth and self.error <= self.allowed


def check_derivatives(compiled: CompiledProblem, *, points: int = 3, seed: int = 0) -> list[DerivativeCheck]:
    """Compare every derivative of a compiled problem with differences; return the worst point of each block.

    Models without derivatives are left out.

    Args:
        compiled: the problem, compiled with or without checks.
        points: nodes of the initial guess per mode; each is checked once as it is, and once with a random displacement.
        seed: seed of the random displacements.
    """
    rng = np.random.default_rng(seed)
    worst: dict[tuple[str, str, str, str], DerivativeCheck] = {}
    for check in _checks(compiled, points, rng):
        key = (check.where, check.output, check.by, check.term)
        known = worst.get(key)
        if known is None or _relative_error(check) > _relative_error(known):
            rates = [each.rate for each in (known, check) if each is not None and each.rate is not None]
            worst[key] = replace(check, rate=min(rates, default=None))
    return list(worst.values())


def _relative_error(check: DerivativeCheck) -> tuple[bool, float]:
    return (not check.agrees, check.error / check.allowed if check.allowed > 0 else np.inf)


def _checks(compiled: CompiledProblem, points: int, rng: np.random.Generator) -> Iterator[DerivativeCheck]:
    for mode in dict.fromkeys(phase.mode for phase in compiled.phases):
        if not mode.model.has_derivatives:
            continue
        phases = [phase for phase in compiled.phases if phase.mode is mode]
        nodes = [(phase, k) for phase in phases for k in range(phase.num_stages)]
        ends = [(phase, phase.num_stages) for phase in phases]
        for places, check_at in ((nodes, _stage), (ends, _terminal)):
            chosen = [places[i] for i in np.unique(np.linspace(0, len(places) - 1, points).astype(int))]
            for phase, k in chosen:
                for size in (0.0, 0.1):
                    yield from check_at(compiled, phase, k, size, rng)
    seen: set[LoweredTransition] = set()
    for phase, following in zip(compiled.phases[:-1], compiled.phases[1:], strict=True):
        if phase.transition is not None and (phase.transition not in seen or phase.resets):
            seen.add(phase.transition)
            for size in (0.0, 0.1):
                yield from _reset(compiled, phase, following, size, rng)


# ---- the functions that are checked


def _stage(
    compiled: CompiledProblem, phase: CompiledPhase, k: int, size: float, rng: np.random.Generator
) -> Iterator[DerivativeCheck]:
    mode, p = phase.mode, phase.p[k]
    f, space, ndx, nu = mode.functions, mode.state, mode.state.ndx, mode.nu
    x = space.np_plus(phase.guess_states[k], size * rng.standard_normal(ndx))
    u = phase.guess_controls[k] + 10 * size * rng.standard_normal(nu)
    z = solve(f["implicit"], x, u, p)
    if not np.all(np.isfinite(z)):
        return
    stage, implicit, stage_d = (Vectorised(f[name]) for name in ("stage", "implicit", "stage_d"))
    xn = space.np_plus(stage(x[None], u[None], z[None], p[None])[0][0], 0.05 * rng.standard_normal(ndx))

    def values(w: Array, solved: bool) -> list[Array]:
        n = len(w)
        ps, xs, us = np.tile(p, (n, 1)), space.np_plus(x, w[:, :ndx]), u + w[:, ndx : ndx + nu]
        K, r0 = implicit(xs, us, ps)
        zs = solve_implicit(K, r0) if solved else z + w[:, ndx + nu :]
        x_next, residual, g, h = stage(xs, us, zs, ps)
        r = r0 + (K @ zs[:, :, None])[:, :, 0]
        return [r, space.np_minus(x_next, xn), residual, g, h]

    r_w, d_w, res_w, g_w, h_w, d_z, res_z, g_z, h_z = (
        a[0] for a in stage_d(x[None], u[None], z[None], p[None], xn[None])
    )
    K, r0 = (a[0] for a in implicit(x[None], u[None], p[None]))
    names = ("r", "d", "residual", "g", "h")
    by_w, by_z = (r_w, d_w, res_w, g_w, h_w), (K, d_z, res_z, g_z, h_z)
    scale = np.concatenate([np.ones(ndx), np.maximum(1, np.abs(u)), np.maximum(1, np.abs(z))])
    partial = [np.hstack([a, b]) for a, b in zip(by_w, by_z, strict=True)]
    differences = differences_of(lambda w: values(w, False), scale)
    terms = np.abs(r0) + np.abs(K) @ np.abs(z)  # r is almost zero here, a sum of forces and torques that cancel
    differences[0] = replace(differences[0], size=np.maximum(differences[0].size, terms))
    for name, J, difference in zip(names, partial, differences, strict=True):
        yield from _compare(compiled, mode, f"stage_{name}", name, J, difference, (ndx, nu), _NOISE)
    if mode.nz:
        z_w = -np.linalg.solve(K, r_w)
        totals = differences_of(lambda w: values(w, True), scale[: ndx + nu])[1:]
        for name, a, b, difference in zip(names[1:], by_w[1:], by_z[1:], totals, strict=True):
            yield from _compare(
                compiled, mode, f"stage_{name}", f"{name} (z)", a + b @ z_w, difference, (ndx, nu), _NOISE_SOLVED
            )


def _terminal(
    compiled: CompiledProblem, phase: CompiledPhase, k: int, size: float, rng: np.random.Generator
) -> Iterator[DerivativeCheck]:
    mode, p = phase.mode, phase.p_end
    space = mode.state
    x = space.np_plus(phase.guess_states[k], size * rng.standard_normal(space.ndx))
    terminal = Vectorised(mode.functions["terminal"])
    jacobians = Vectorised(mode.functions["terminal_d"])(x[None], p[None])
    differences = differences_of(lambda w: terminal(space.np_plus(x, w), np.tile(p, (len(w), 1))), np.ones(space.ndx))
    for name, J, difference in zip(("residual", "g", "h"), jacobians, differences, strict=True):
        yield from _compare(compiled, mode, f"terminal_{name}", f"end {name}", J[0], difference, (space.ndx, 0), _NOISE)


def _reset(
    compiled: CompiledProblem, phase: CompiledPhase, following: CompiledPhase, size: float, rng: np.random.Generator
) -> Iterator[DerivativeCheck]:
    transition, p = phase.transition, phase.p_transition
    assert transition is not None  # only called between phases
    f, space, after = transition.functions, transition.source.state, transition.target.state
    x = space.np_plus(phase.guess_states[-1], size * rng.standard_normal(space.ndx))
    z = solve(f["implicit"], x, p)
    if not np.all(np.isfinite(z)):
        return
    implicit, reset, reset_d, rows, rows_d = (
        Vectorised(f[name]) for name in ("implicit", "reset", "reset_d", "rows", "rows_d")
    )
    xn = after.np_plus(reset(x[None], z[None], p[None])[0][0], 0.05 * rng.standard_normal(after.ndx))

    def values(w: Array, solved: bool) -> list[Array]:
        ps, xs = np.tile(p, (len(w), 1)), space.np_plus(x, w[:, : space.ndx])
        K, r0 = implicit(xs, ps)
        zs = solve_implicit(K, r0) if solved else z + w[:, space.ndx :]
        return [r0 + (K @ zs[:, :, None])[:, :, 0], after.np_minus(reset(xs, zs, ps)[0], xn), *rows(xs, zs, ps)]

    r_x, d_x, d_z = (a[0] for a in reset_d(x[None], z[None], p[None], xn[None]))
    by = [a[0] for a in rows_d(x[None], z[None], p[None])]
    K = implicit(x[None], p[None])[0][0]
    where = f"reset '{phase.name}' → '{following.name}'"
    labels = {"r": tuple(f"row {i}" for i in range(len(z))), "d": after.labels}
    scale, split = np.concatenate([np.ones(space.ndx), np.maximum(1, np.abs(z))]), (space.ndx, 0)
    by_x, by_z = (r_x, d_x, *by[:3]), (K, d_z, *by[3:])
    partial = [np.hstack([a, b]) for a, b in zip(by_x, by_z, strict=True)]
    differences = differences_of(lambda w: values(w, False), scale)
    found = list(zip(("r", "d", *transition.rows), partial, differences, strict=True))
    for name, J, difference in found[:2]:
        yield from _blocks(where, name, transition.source.name, labels[name], J, difference, split, _NOISE)
    for name, J, difference in found[2:]:
        yield from _by_term(compiled, where, transition.rows[name], name, J, difference, split, _NOISE)
    if transition.nz:
        z_x = -np.linalg.solve(K, r_x)
        totals = differences_of(lambda w: values(w, True), np.ones(space.ndx))[1:]
        solved = [a + b @ z_x for a, b in zip(by_x[1:], by_z[1:], strict=True)]
        yield from _blocks(
            where, "d (z)", transition.source.name, after.labels, solved[0], totals[0], split, _NOISE_SOLVED
        )
        for (name, rows_of), J, total in zip(transition.rows.items(), solved[1:], totals[1:], strict=True):
            yield from _by_term(compiled, where, rows_of, f"{name} (z)", J, total, split, _NOISE_SOLVED)


# ---- comparison


def _compare(
    compiled: CompiledProblem, mode: LoweredMode, group: str, output: str, J: Array, difference: Difference,
    split: tuple[int, int], noise: float,
) -> Iterator[DerivativeCheck]:  # fmt: skip
    """Yield the checks of one output of a mode, term by term."""
    where = f"model '{mode.model.name}', mode '{mode.key}'"
    if group not in mode.rows:
        labels = mode.state.labels if output.startswith("d") else tuple(f"row {i}" for i in range(len(J)))
        yield from _blocks(where, output, mode.model.name, labels, J, difference, split, noise)
        return
    yield from _by_term(compiled, where, mode.rows[group], output, J, difference, split, noise)


def _by_term(
    compiled: CompiledProblem, where: str, rows: Sequence[Row], output: str, J: Array, difference: Difference,
    split: tuple[int, int], noise: float,
) -> Iterator[DerivativeCheck]:  # fmt: skip
    """Yield the checks of rows of terms."""
    for term in dict.fromkeys(row.term for row in rows):
        index = [i for i, row in enumerate(rows) if row.term == term]
        labels = tuple(compiled.row_name(rows[i]) for i in index)
        source = str(compiled.terms[term].source) if term >= 0 else ""
        for check in _blocks(
            where, output, compiled.term_name(rows[index[0]]), labels, J[index], difference.part(index), split, noise
        ):
            yield replace(check, source=source)


def _blocks(
    where: str, output: str, term: str, labels: Sequence[str], J: Array, difference: Difference,
    split: tuple[int, int], noise: float,
) -> Iterator[DerivativeCheck]:  # fmt: skip
    """Yield one check each for the columns of x, of u and of z."""
    edges = (0, split[0], split[0] + split[1], J.shape[1])
    for by, first, last in zip("xuz", edges[:-1], edges[1:], strict=True):
        if last == first or len(J) == 0:
            continue
        part = difference.part(slice(None), slice(first, last))
        J_by = J[:, first:last]
        rounding = noise * np.finfo(float).eps * np.maximum(1.0, part.size)[:, None] / STEP
        finite = np.isfinite(J_by) & np.isfinite(part.full) & np.isfinite(part.half)
        truncation = np.abs(np.where(finite, part.full, 0.0) - np.where(finite, part.half, 0.0)) / 3
        allowed = _MARGIN * truncation + np.where(np.isfinite(rounding), rounding, 0.0)
        error = np.where(finite, np.abs(np.where(finite, J_by, 0.0) - np.where(finite, part.half, 0.0)), np.inf)
        ratio = np.divide(error, allowed, where=allowed > 0, out=np.full_like(error, np.inf))
        row, column = (int(i) for i in np.unravel_index(int(np.argmax(ratio)), ratio.shape))
        rough = _ROUGH * (1.0 + np.max(np.abs(part.half), where=finite, initial=0.0))
        smooth = bool(np.max(truncation, initial=0.0) <= rough) and not part.has_kink(rough)
        rate = rate_of(J_by, part.coarse, part.coarse_half, float(rounding.max())) if finite.all() else None
        yield DerivativeCheck(
            where, output, by, term, labels[row], float(error[row, column]), float(allowed[row, column]), rate, smooth
        )
