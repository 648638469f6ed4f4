"""Checks of a compiled problem before any solve: targets, controls without cost, NaN at the initial guess."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError, ProblemError, UnknownNameError

from .batch import Batch
from .compiled import CompiledPhase, CompiledProblem
from .given import numbers_of
from .lowering import Row
from .model import ModelBase
from .motion import Motion
from .quantity import Quantity
from .schedule import Schedule
from .term import ByPhase, Constraint, Cost

if TYPE_CHECKING:
    from .problem import Problem

Array = NDArray[np.float64]


def check_targets(motion: Motion, models: list[ModelBase]) -> None:
    """Raise if a keyframe speaks of something that no model has, or gives it another size."""
    for phase in (phase for piece in motion.pieces for phase in piece.phases):
        for name, value in phase.target.values.items() if phase.target else ():
            errors: list[Exception] = []
            for model in models:
                try:
                    _check_finite_target(model.keyframe({name: value}))
                    break
                except (ModelError, ProblemError) as error:
                    errors.append(error)
                except (TypeError, ValueError):
                    numbers_of(value, f"phase '{phase.name}' ({phase.source}), keyframe", f"target '{name}'")
                    raise
            else:  # the most telling: a model that knows the name, but not with this value
                telling = next((e for e in errors if not isinstance(e, UnknownNameError)), errors[0])
                raise ProblemError(f"phase '{phase.name}' ({phase.source}): {telling}") from telling


def _check_finite_target(targets: dict[Quantity, Array]) -> None:
    for quantity, value in targets.items():
        if not np.all(np.isfinite(value)):
            raise ProblemError(
                f"keyframe, target '{quantity}': is not finite - got {np.asarray(value).tolist()}, expected finite "
                "numbers; mend it"
            )


def check_last(motion: Motion) -> None:
    """Raise if a reset map stands at the end of a motion, where nothing follows."""
    if motion.duration == float("inf"):
        return
    *before, last = (phase for piece in motion.pieces for phase in piece.phases)
    if last.reset is not None and last not in before:
        raise ProblemError(
            f"phase '{last.name}' ({last.source}): its reset applies nowhere - got the motion's last phase, expected "
            "another after it; add one, or remove the reset"
        )


def check_models(schedule: Schedule) -> None:
    """Raise if two models share a name: reports, files and parameters could not tell them apart."""
    named: dict[str, ModelBase] = {}
    for segment in schedule.segments:
        model = segment.model
        if named.setdefault(model.name, model) is not model:
            raise ProblemError(
                f"schedule ({segment.source}): two models share a name - got '{model.name}' twice, expected one model, "
                "or another name; use one object, or give one of them name="
            )


def check_names(problem: Problem, terms: tuple[Cost | Constraint, ...]) -> None:
    """Raise if a term speaks of a phase, or a schedule leaves out a term, that is not there."""
    phases = dict.fromkeys(phase.name for piece in problem.motion.pieces for phase in piece.phases)
    for term in terms:
        named = list(term.when) if isinstance(term.when, tuple) else [term.when] if isinstance(term.when, str) else []
        if isinstance(term, Cost) and isinstance(term.weight, ByPhase):
            named += term.weight.phases
        for name in named:
            if name not in phases:
                raise UnknownNameError(f"term '{term.name}' ({term.source})", "phase", name, phases)
    for segment in problem.schedule.segments:
        for term in segment.excluded:
            if term not in terms:
                raise ProblemError(
                    f"schedule ({segment.source}), model '{segment.model.name}': leaves out a term that is not in the "
                    f"problem - got '{term.name}' ({term.source}), expected one of its terms; pass the very object "
                    "that the problem has"
                )


def require_derivatives(problem: Problem | CompiledProblem, solver: str) -> None:
    """Raise if a solver that differentiates is given a model that can only be simulated.

    Args:
        problem: the problem, compiled or not.
        solver: its name, for the message.
    """
    if isinstance(problem, CompiledProblem):
        used = [(f"phase '{p.name}' ({p.interval.phase.source})", p.mode.model) for p in problem.phases]
    else:
        used = [(f"schedule ({segment.source})", segment.model) for segment in problem.schedule.segments]
    for where, model in used:
        if not model.has_derivatives:
            raise ProblemError(
                f"{where}, model '{model.name}': has no derivatives - got a model that can only be simulated, expected "
                f"one whose dynamics is an expression, for {solver}; schedule another model, or use a sampling "
                "controller"
            )


def solve_implicit(K: Array, r0: Array) -> Array:
    """Return z = −K⁻¹ r0 for stacked nodes, (n, nz)."""
    if r0.shape[1] == 0:
        return r0
    return np.asarray(-np.linalg.solve(K, r0[:, :, None])[:, :, 0])


class Guess:
    """What the functions of a phase give at its initial guess, by name, each evaluated once.

    Args:
        phase: the compiled phase.
    """

    def __init__(self, phase: CompiledPhase) -> None:
        self.phase = phase
        self.x, self.u = phase.guess_states, phase.guess_controls
        self.has_derivatives = phase.mode.model.has_derivatives

    @cached_property
    def _implicit(self) -> dict[str, Array]:
        return _named(self.phase.mode.functions["implicit"], self.x[:-1], self.u, self.phase.p)

    @cached_property
    def z(self) -> Array:
        """Implicit variables (N, nz); NaN if their equations have no solution."""
        if not self.has_derivatives:
            return np.zeros((self.phase.num_stages, self.phase.mode.nz))
        return _solved(self._implicit["K"], self._implicit["r0"])

    @cached_property
    def stage(self) -> dict[str, Array]:
        """Values of the stages."""
        return _named(self.phase.mode.functions["stage"], self.x[:-1], self.u, self.z, self.phase.p)

    @cached_property
    def stage_d(self) -> dict[str, Array]:
        """Derivatives of the stages; empty for a model that has none."""
        if not self.has_derivatives:
            return {}
        return _named(self.phase.mode.functions["stage_d"], self.x[:-1], self.u, self.z, self.phase.p, self.x[1:])

    @cached_property
    def terminal(self) -> dict[str, Array]:
        """Values of the last node's rows."""
        return _named(self.phase.mode.functions["terminal"], self.x[-1:], self.phase.p_end[None])

    @cached_property
    def terminal_d(self) -> dict[str, Array]:
        """Derivatives of the last node's rows; empty for a model that has none."""
        if not self.has_derivatives:
            return {}
        return _named(self.phase.mode.functions["terminal_d"], self.x[-1:], self.phase.p_end[None])

    @cached_property
    def reset(self) -> tuple[dict[str, Array], dict[str, Array]]:
        """Values and derivatives of what happens after the phase; empty if nothing does."""
        if self.phase.transition is None or not self.phase.resets:
            return {}, {}
        functions, x, p = self.phase.transition.functions, self.x[-1:], self.phase.p_transition[None]
        implicit = _named(functions["implicit"], x, p)
        z = _solved(implicit["K"], implicit["r0"])
        values = _named(functions["reset"], x, z, p)
        return values, _named(functions["reset_d"], x, z, p, values["x_next"])

    def control_curvature(self) -> Array:
        """Return the largest curvature of the running cost by each control over the stages, z chained in, (nu,)."""
        by_w = self.stage_d["residual_w"]
        if self.phase.mode.nz and by_w.shape[1]:
            by_w = by_w - self.stage_d["residual_z"] @ np.linalg.solve(self._implicit["K"], self.stage_d["r_w"])
        slopes = by_w[:, :, self.phase.mode.state.ndx :]
        return np.asarray(np.einsum("nr,nru->nu", self.phase.weight, slopes**2).max(axis=0))


def check_guess(compiled: CompiledProblem) -> None:
    """Raise if something is not finite at the initial guess, or a control has no cost there."""
    guesses = [Guess(phase) for phase in compiled.phases]
    check_finite(compiled, guesses)
    check_controls(compiled, guesses)


def check_controls(compiled: CompiledProblem, guesses: list[Guess] | None = None) -> None:
    """Raise if some control has no running cost anywhere in a mode: its Hessian would be singular.

    Models without derivatives are sampled, and need none.
    """
    guesses = [g for g in guesses or [Guess(phase) for phase in compiled.phases] if g.has_derivatives]
    for mode in dict.fromkeys(guess.phase.mode for guess in guesses):
        if mode.nu == 0:
            continue
        phase = next(guess.phase for guess in guesses if guess.phase.mode is mode)
        where = f"phase '{phase.name}' ({phase.interval.phase.source})"
        curvature = np.max([guess.control_curvature() for guess in guesses if guess.phase.mode is mode], axis=0)
        for i in np.flatnonzero(curvature <= 0.0):
            label = mode.model.control.labels[i].strip()
            raise ProblemError(
                f"{where}, model '{mode.model.name}', mode '{mode.key}': a control has no running cost - got none on "
                f"'{label}', expected at least a small one; add ocp.regularize('{label.split()[0]}', weight=...) "
                "to the objective"
            )


def check_finite(compiled: CompiledProblem, guesses: list[Guess] | None = None) -> None:
    """Raise if a value or derivative is NaN or infinite at the initial guess; name the term and the node."""
    guesses = guesses or [Guess(phase) for phase in compiled.phases]
    for guess in guesses:
        n = guess.phase.num_stages
        for group, first, tables in (
            ("stage", 0, (guess.stage, guess.stage_d)),
            ("terminal", n, (guess.terminal, guess.terminal_d)),
            ("reset", n, guess.reset),
        ):
            for what, results in zip(("value", "derivative"), tables, strict=True):
                for name, array in results.items():
                    if np.all(np.isfinite(array)):
                        continue
                    node, row = (int(i) for i in np.argwhere(~np.isfinite(array))[0][:2])
                    got = "NaN" if np.isnan(array[node, row]).any() else "infinity"
                    raise ProblemError(
                        f"{owner_of(compiled, guess.phase, group, name, row)}, phase '{guess.phase.name}', node "
                        f"{first + node}: {what} at the initial guess is not finite - got {got}, expected finite "
                        "numbers; move the guess or the term away from the singularity"
                    )


def owner_of(compiled: CompiledProblem, phase: CompiledPhase, group: str, name: str, row: int) -> str:
    """Return what a row of a function belongs to, in words: a term and where it was declared, or dynamics or a reset.

    Args:
        compiled: the problem.
        phase: one of its phases.
        group: ``"stage"``, ``"terminal"`` or ``"reset"``.
        name: an output of the group's functions, such as ``"g"`` or ``"residual_w"``.
        row: its row.
    """
    kind, model = name.split("_")[0], phase.mode.model
    if group != "reset" and kind in ("residual", "g", "h"):
        owner: Row = phase.mode.rows[f"{group}_{kind}"][row]
        source = f" ({compiled.terms[owner.term].source})" if owner.term >= 0 else ""
        return f"term '{compiled.row_name(owner)}'{source}"
    if group == "reset":
        return f"reset of model '{model.name}' ({phase.interval.phase.source})"
    if name == "x_next":
        block = next(b for b in model.state.blocks if model.state.slices[b.quantity].stop > row)
        return f"dynamics of model '{model.name}' ({phase.interval.phase.source}), next '{block.quantity}'"
    return f"dynamics of model '{model.name}' ({phase.interval.phase.source}), function '{name}'"


def _named(function: cs.Function, *arguments: Array) -> dict[str, Array]:
    return dict(zip(function.name_out(), Batch(function)(*arguments), strict=True))


def _solved(K: Array, r0: Array) -> Array:
    try:
        return solve_implicit(K, r0)
    except np.linalg.LinAlgError:
        return np.full_like(r0, np.nan)
