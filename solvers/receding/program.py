"""The compiled library of a receding horizon: generated functions of its problem, and a template."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from importlib.resources import files
from typing import Any

from piaffe.codegen import SOLVER_FLAGS, LoadedLibrary, build, generate, load

from ..ilqr import TEMPLATES, constants_header
from ..tracking import PLAN_HEADER

_FILES = (
    "receding.h",
    "motions.h",
    "calendar.inc",
    "course.inc",
    "layout.inc",
    "numbers.inc",
    "shift.inc",
    "rows.inc",
    "predict.inc",
    "clock.inc",
    "motions.inc",
)


@lru_cache(maxsize=8)
def receding_library(
    functions: tuple[tuple[str, Any], ...], width: int, sizes: str
) -> tuple[LoadedLibrary, Mapping[str, int]]:
    """Return the library, and the size of the work array of each function.

    Args:
        functions: name and function of each, see :func:`generated_functions`.
        width: doubles per vector, that of the solver's library.
        sizes: text of the solver's ``sizes.h``.
    """
    made = generate(dict(functions))
    template = files(__package__).joinpath("template")
    texts = {name: template.joinpath(name).read_text(encoding="utf-8") for name in (*_FILES, "receding.c")}
    shared = {name: TEMPLATES[name] for name in ("piaffe.h", "manifold.inc")}
    own = {name: texts[name] for name in _FILES}
    headers = {**made.headers, **shared, **own, "constants.h": constants_header()}
    headers |= {"sizes.h": sizes, "plan.h": PLAN_HEADER}
    units = [*((unit.name, unit.text) for unit in made.units), ("receding", texts["receding.c"])]
    built = build(
        units, headers=headers, flags_per_unit={"receding": SOLVER_FLAGS}, width=width, label="receding horizon"
    )
    return load(built), made.work
