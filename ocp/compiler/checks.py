"""Checks of a declaration while it is compiled: targets, names, models, derivatives."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError, ProblemError, ShapeError, UnknownNameError

from ..language import (
    ByPhase,
    Constraint,
    Cost,
    FromArrays,
    ModelBase,
    Motion,
    Quantity,
    Schedule,
    model_of,
    numbers_of,
)
from .compiled import CompiledProblem

if TYPE_CHECKING:
    from ..language import Problem

Array = NDArray[np.float64]


def check_targets(motion: Motion, models: list[ModelBase]) -> None:
    """Raise if a keyframe has a target that no model has, or one of another size or not finite."""
    for phase in (phase for piece in motion.pieces for phase in piece.phases):
        values = phase.target.values if phase.target else {}
        try:
            for model in models:
                values = model.complete_keyframe(values)
        except (ModelError, ShapeError, UnknownNameError) as error:
            raise ProblemError(f"phase '{phase.name}' ({phase.source}): {error}") from error
        for name, value in values.items():
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
            else:  # the most precise error is that of a model that has the target, but not with this value
                precise = next((e for e in errors if not isinstance(e, UnknownNameError)), errors[0])
                raise ProblemError(f"phase '{phase.name}' ({phase.source}): {precise}") from precise


def check_columns(motion: Motion, models: list[ModelBase], terms: Iterable[Cost | Constraint]) -> None:
    """Raise if arrays of targets have a column that no model and no cost has, or the name of a model's quantity."""
    tracked = {term.quantity for term in terms if isinstance(term, Cost)}
    for reference in {piece.reference for piece in motion.pieces if isinstance(piece.reference, FromArrays)}:
        for column, values in reference.columns.items():
            known = [quantity for model in models for quantity in _named(model, column.path, values[0])]
            where = f"FromArrays ({reference.source}), '{column}'"
            if column in tracked or column in known:
                continue
            if known:
                raise ProblemError(
                    f"{where}: is the name of a quantity - got text, expected the quantity itself, which says how it "
                    f"is interpolated; write models.{column} without quotes"
                )
            names = ", ".join(f"'{model.name}'" for model in models)
            raise ProblemError(
                f"{where}: no model has it, and no cost tracks it - got models {names}, expected a quantity of one of "
                "them; correct the name, or remove the column"
            )


def _named(model: ModelBase, path: str, row: Array) -> list[Quantity]:
    """Return a model's quantities of a name; of a rotation, which a keyframe gives as three angles, too."""
    for value in (row, np.zeros(3)):
        try:
            return list(model.keyframe({path: value}))
        except UnknownNameError:
            return []
        except (ModelError, ProblemError, TypeError, ValueError):
            continue
    return [Quantity(path)]  # the size is wrong, which is another message


def _check_finite_target(targets: dict[Quantity, Array]) -> None:
    for quantity, value in targets.items():
        if not np.all(np.isfinite(value)):
            raise ProblemError(
                f"keyframe, target '{quantity}': is not finite - got {np.asarray(value).tolist()}, expected finite "
                "numbers; fix it"
            )


def check_last(motion: Motion) -> None:
    """Raise if the last phase of a motion has a reset map."""
    if motion.duration == float("inf"):
        return
    *before, last = (phase for piece in motion.pieces for phase in piece.phases)
    if last.reset is not None and last not in before:
        raise ProblemError(
            f"phase '{last.name}' ({last.source}): its reset applies nowhere - got the motion's last phase, expected "
            "another after it; add one, or remove the reset"
        )


def check_models(schedule: Schedule) -> None:
    """Raise if two models share a name: reports, files and parameters identify a model by its name."""
    named: dict[str, ModelBase] = {}
    for segment in schedule.segments:
        model = model_of(segment)
        if named.setdefault(model.name, model) is not model:
            raise ProblemError(
                f"schedule ({segment.source}): two models share a name - got '{model.name}' twice, expected one model, "
                "or another name; use one object, or give one of them name="
            )


def check_names(problem: Problem, terms: tuple[Cost | Constraint, ...]) -> None:
    """Raise if a term names an unknown phase, or a schedule leaves out a term that the problem does not have."""
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
                    f"problem - got '{term.name}' ({term.source}), expected one of its terms; pass the same object "
                    "as the problem has"
                )


def require_derivatives(problem: Problem | CompiledProblem, solver: str) -> None:
    """Raise if a solver that needs derivatives gets a model that can only be simulated.

    Args:
        problem: the problem, compiled or not.
        solver: name of the solver, for the message.
    """
    if isinstance(problem, CompiledProblem):
        used = [(f"phase '{p.name}' ({p.interval.phase.source})", p.mode.model) for p in problem.phases]
    else:
        used = [(f"schedule ({segment.source})", model_of(segment)) for segment in problem.schedule.segments]
    for where, model in used:
        if not model.has_derivatives:
            raise ProblemError(
                f"{where}, model '{model.name}': has no derivatives - got a model that can only be simulated, expected "
                f"one whose dynamics is an expression, for {solver}; schedule another model, or use a sampling "
                "controller"
            )
