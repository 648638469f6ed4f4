"""Targets that models add to those of a motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from piaffe.errors import ProblemError

from ..language import AddedTargets, ModelBase, Path


def with_added(path: Path, models: Sequence[ModelBase], where: str) -> Path:
    """Return a path with what models add to its targets.

    Args:
        path: the path of the motion.
        models: the models of the schedule.
        where: the problem, for messages.

    Raises:
        ProblemError: two models add targets of different origins.
    """
    found: list[tuple[ModelBase, AddedTargets]] = []
    for model in models:
        added = model.added_targets(path)
        if not isinstance(added, AddedTargets):
            continue
        if found and found[0][1].origin != added.origin:
            raise ProblemError(
                f"{where}: two models of the schedule have different ground - got {found[0][1].origin} of "
                f"'{found[0][0].name}' and {added.origin} of '{model.name}', expected the same; give it to both"
            )
        found.append((model, added))
    return replace(path, added=(found[0][1],)) if found else path
