"""Checks of a compiled problem at its initial guess: numbers that are not finite, and controls without a cost."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import starmap
from typing import TYPE_CHECKING

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError

from .compiled import CompiledProblem
from .compiled_phase import CompiledPhase
from .mode import Row
from .transition import LoweredTransition
from .vectorised import Vectorised

if TYPE_CHECKING:
    pass

Array = NDArray[np.float64]


def solve_implicit(K: Array, r0: Array) -> Array:
    """Return z = −K⁻¹ r0 for stacked nodes, (n, nz)."""
    if r0.shape[1] == 0:
        return r0
    return np.asarray(-np.linalg.solve(K, r0[:, :, None])[:, :, 0])


class Guess:
    """Values of a mode's functions at the initial guess of phases, by name; each function is evaluated once.

    Args:
        phases: compiled phases of one mode; results have the nodes of all phases, one phase after another.
    """

    def __init__(self, *phases: CompiledPhase) -> None:
        self.phases, self.mode = phases, phases[0].mode
        self.x = np.concatenate([phase.guess_states[:-1] for phase in phases])
        self.u = np.concatenate([phase.guess_controls for phase in phases])
        self.p = np.concatenate([phase.p for phase in phases])
        self.end = np.array([phase.guess_states[-1] for phase in phases]), np.array([phase.p_end for phase in phases])
        self.has_derivatives = self.mode.model.has_derivatives

    @cached_property
    def _implicit(self) -> _Values:
        return _Values(self.mode.functions["implicit"], self.x, self.u, self.p)

    @cached_property
    def z(self) -> Array:
        """Implicit variables (N, nz); NaN if their equations have no solution."""
        if not self.has_derivatives:
            return np.zeros((len(self.x), self.mode.nz))
        return _solved(self._implicit["K"], self._implicit["r0"])

    @cached_property
    def stage(self) -> Mapping[str, Array]:
        """Values of the stages."""
        return _Values(self.mode.functions["stage"], self.x, self.u, self.z, self.p)

    @cached_property
    def stage_d(self) -> Mapping[str, Array]:
        """Derivatives of the stages that may be infinite at finite values; empty for a model without derivatives."""
        if not self.has_derivatives:
            return {}
        after = np.concatenate([phase.guess_states[1:] for phase in self.phases])
        return _Values(self.mode.functions["guess_d"], self.x, self.u, self.z, self.p, after)

    @cached_property
    def terminal(self) -> Mapping[str, Array]:
        """Values of the last nodes' rows."""
        return _Values(self.mode.functions["terminal"], *self.end)

    @cached_property
    def terminal_d(self) -> Mapping[str, Array]:
        """Derivatives of the last nodes' rows; empty for a model without derivatives."""
        return _Values(self.mode.functions["terminal_d"], *self.end) if self.has_derivatives else {}

    def control_curvature(self) -> Array:
        """Return the largest second derivative of the running cost by each control, with z = z(x, u), (nu,)."""
        by_u, ndx = self.stage_d["residual_w"][:, :, self.mode.state.ndx :], self.mode.state.ndx
        if self.mode.nz and by_u.shape[1]:
            minus_z_u = np.linalg.solve(self._implicit["K"], self.stage_d["r_w"][:, :, ndx:])
            by_u = by_u - self.stage_d["residual_z"] @ minus_z_u
        weight = np.concatenate([phase.weight for phase in self.phases])
        return np.asarray(np.einsum("nr,nru->nu", weight, by_u**2).max(axis=0))


class ResetGuess:
    """Values of a transition's functions at the initial guess of the phases that end with it.

    Args:
        transition: the transition.
        phases: the phases that end with it.
    """

    def __init__(self, transition: LoweredTransition, phases: Sequence[CompiledPhase]) -> None:
        f = transition.functions
        x, p = np.array([phase.guess_states[-1] for phase in phases]), np.array([each.p_transition for each in phases])
        implicit = _Values(f["implicit"], x, p)
        z = _solved(implicit["K"], implicit["r0"])
        self.values = _Values(f["reset"], x, z, p)
        self.derivatives = _Values(f["reset_d"], x, z, p, self.values["x_next"])
        lands = np.array([phase.lands for phase in phases])
        self.rows, self.rows_d = (_Values(f[name], x[lands], z[lands], p[lands]) for name in ("rows", "rows_d"))

    @property
    def tables(self) -> tuple[_Values, ...]:
        """All values and derivatives; of the transition's rows those at impacts."""
        return self.values, self.derivatives, self.rows, self.rows_d


def end_values(phase: CompiledPhase) -> dict[str, Array]:
    """Return the values of a phase's ``end_rows`` at the initial guess, by kind, (1, rows)."""
    own = dict(Guess(phase).terminal)
    if phase.transition is None or not phase.transition.num_rows:
        return own
    if not phase.lands:
        return {kind: np.pad(values, ((0, 0), (0, len(phase.transition.rows[kind])))) for kind, values in own.items()}
    added = ResetGuess(phase.transition, [phase]).rows
    return {kind: np.concatenate([values, added[kind]], axis=1) for kind, values in own.items()}


def by_mode(compiled: CompiledProblem) -> list[Guess]:
    """Return one guess per mode, for all phases of the mode."""
    modes = dict.fromkeys(phase.mode for phase in compiled.phases)
    return [Guess(*(phase for phase in compiled.phases if phase.mode is mode)) for mode in modes]


def check_guess(compiled: CompiledProblem) -> None:
    """Raise if a value or derivative is not finite at the initial guess, or a control has no cost there."""
    guesses = by_mode(compiled)
    check_finite(compiled, guesses)
    check_controls(compiled, guesses)


def check_controls(compiled: CompiledProblem, guesses: list[Guess] | None = None) -> None:
    """Raise if a control has no running cost at any stage of a mode: the Hessian by the controls would be singular.

    Models without derivatives need no such cost; only sampling controllers use them.
    """
    for guess in guesses or by_mode(compiled):
        phase, mode = guess.phases[0], guess.mode
        if mode.nu == 0 or not guess.has_derivatives:
            continue
        where = f"phase '{phase.name}' ({phase.interval.phase.source})"
        for i in np.flatnonzero(guess.control_curvature() <= 0.0):
            label = mode.model.control.labels[i].strip()
            raise ProblemError(
                f"{where}, model '{mode.model.name}', mode '{mode.key}': a control has no running cost - got none on "
                f"'{label}', expected at least a small one; add ocp.regularize('{label.split()[0]}', weight=...) "
                "to the objective"
            )


def check_finite(compiled: CompiledProblem, guesses: list[Guess] | None = None) -> None:
    """Raise if a value or derivative is NaN or infinite at the initial guess; name the term and the node."""
    resets: dict[LoweredTransition, list[CompiledPhase]] = {}
    for phase in compiled.phases:
        if phase.transition is not None and phase.resets:
            resets.setdefault(phase.transition, []).append(phase)
    tables = [t for g in guesses or by_mode(compiled) for t in (g.stage, g.stage_d, g.terminal, g.terminal_d)]
    tables += [table for guess in starmap(ResetGuess, resets.items()) for table in guess.tables]
    if all(table.is_finite for table in tables if isinstance(table, _Values)):
        return
    for applies in (True, False):  # a row of another phase is not finite in the solver's memory, either
        for phase in compiled.phases:
            _raise_for_first(compiled, phase, applies=applies)


def _raise_for_first(compiled: CompiledProblem, phase: CompiledPhase, *, applies: bool) -> None:
    """Raise for the first value or derivative of a phase that is not finite, if there is any.

    Args:
        compiled: the problem.
        phase: one of its phases.
        applies: whether to look only at dynamics and at terms where they apply.
    """
    guess, n = Guess(phase), phase.num_stages
    pairs = [
        ("stage", 0, (guess.stage, guess.stage_d)),
        ("terminal", n, (guess.terminal, guess.terminal_d)),
    ]
    if phase.transition is not None and phase.resets:
        reset = ResetGuess(phase.transition, [phase])
        pairs += [("reset", n, (reset.values, reset.derivatives)), ("reset", n, (reset.rows, reset.rows_d))]
    for group, first, tables in pairs:
        for what, results in zip(("value", "derivative"), tables, strict=True):
            for name, array in results.items():
                bad = np.argwhere(~np.isfinite(array))
                if applies:
                    bad = bad[[_counts(phase, group, name, first + int(i[0]), int(i[1])) for i in bad]]
                if not len(bad):
                    continue
                node, row = (int(i) for i in bad[0][:2])
                got = "NaN" if np.isnan(array[node, row]).any() else "infinity"
                raise ProblemError(
                    f"{owner_of(compiled, phase, group, name, row)}, phase '{phase.name}', node {first + node}: {what} "
                    f"at the initial guess is not finite - got {got}, expected finite numbers; move the guess or the "
                    "term away from the singularity"
                )


def _counts(phase: CompiledPhase, group: str, name: str, node: int, row: int) -> bool:
    """Return whether a row of a function has an effect at a node: rows of dynamics have, rows of terms may not."""
    kind = name.split("_")[0]
    if kind not in ("residual", "g", "h"):
        return True
    term = _rows_of(phase, group, kind)[row].term
    return term < 0 or bool(phase.applies[node, term])


def owner_of(compiled: CompiledProblem, phase: CompiledPhase, group: str, name: str, row: int) -> str:
    """Return a description of what a row of a function belongs to: a term and its declaration, dynamics or a reset.

    Args:
        compiled: the problem.
        phase: one of its phases.
        group: ``"stage"``, ``"terminal"`` or ``"reset"``.
        name: an output of the group's functions, such as ``"g"`` or ``"residual_w"``.
        row: the row of this output; in the group ``"terminal"``, those of the transition follow those of the mode.
    """
    kind, model = name.split("_")[0], phase.mode.model
    if kind in ("residual", "g", "h"):
        owner: Row = _rows_of(phase, group, kind)[row]
        source = f" ({compiled.terms[owner.term].source})" if owner.term >= 0 else ""
        return f"term '{compiled.row_name(owner)}'{source}"
    if group == "reset":
        return f"reset of model '{model.name}' ({phase.interval.phase.source})"
    if name == "x_next":
        block = next(b for b in model.state.blocks if model.state.slices[b.quantity].stop > row)
        return f"dynamics of model '{model.name}' ({phase.interval.phase.source}), next '{block.quantity}'"
    return f"dynamics of model '{model.name}' ({phase.interval.phase.source}), function '{name}'"


def _rows_of(phase: CompiledPhase, group: str, kind: str) -> tuple[Row, ...]:
    if group == "terminal":
        return phase.end_rows(kind)
    if group == "reset":
        assert phase.transition is not None  # else it has no such rows
        return phase.transition.rows[kind]
    return phase.mode.rows[f"{group}_{kind}"]


class _Values(Mapping[str, Array]):
    """A function's outputs at nodes, by name: (n, rows, cols) of matrices, (n, rows) of columns."""

    def __init__(self, function: cs.Function, *arguments: Array) -> None:
        self._function = Vectorised(function)
        self._nonzeros = dict(zip(self._function.names, self._function.nonzeros(*arguments), strict=True))

    def __getitem__(self, name: str) -> Array:
        return self._function.filled(name, self._nonzeros[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._nonzeros)

    def __len__(self) -> int:
        return len(self._nonzeros)

    @property
    def is_finite(self) -> bool:
        """Whether all values are finite."""
        return all(np.all(np.isfinite(values)) for values in self._nonzeros.values())


def _solved(K: Array, r0: Array) -> Array:
    try:
        return solve_implicit(K, r0)
    except np.linalg.LinAlgError:
        return np.full_like(r0, np.nan)
