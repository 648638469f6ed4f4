"""Reading of a study from a TOML file: the problem, the settings and their combinations."""

from __future__ import annotations

import ast
import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from piaffe.errors import SamplingError, UnknownNameError
from piaffe.files import read_toml

from .declared import Declared, load_declared
from .runner import Runner
from .study import Case, grid
from .trials import complete, located, options_of, plant_of, prepare

OWN = ("file", "seeds", "series", "grid")


@dataclass(frozen=True)
class StudyFile:
    """The content of a study's TOML file.

    Args:
        path: the TOML file.
        spec: the problem's file and name.
        declared: declarations of the problem's file.
        cases: the episodes.
        series: quantities to plot over time, and the limit of each: part of joints' names, or ``height``.
        runners: controllers that sampling does not know, by name.
    """

    path: Path
    spec: str
    declared: Declared
    cases: tuple[Case, ...]
    series: Mapping[str, float]
    runners: Mapping[str, Runner] = field(default_factory=dict)


def read_study(path: Path, runners: Mapping[str, Runner] | None = None) -> StudyFile:
    """Return a study, after all checks that do not need to run it.

    Args:
        path: the TOML file. The paths in ``file`` and ``value`` are relative to it.
        runners: controllers that sampling does not know, by name.

    Raises:
        FileFormatError: it is not a TOML file, or the file of a value is missing.
        SamplingError: an entry is missing or out of range.
        UnknownNameError: a setting or a controller is unknown.
        ProblemError: the problem's file cannot be used, or raises an error for a setting.
    """
    given = read_toml(path, "study")
    where = f"study '{path}'"
    if not isinstance(given.get("file"), str):
        raise SamplingError(
            f"{where}: has no problem - got file = {given.get('file')!r}, expected the path of a Python file, relative "
            'to the study; add file = "trot_mppi.py"'
        )
    blocks = given.get("grid", [{}])
    if not (isinstance(blocks, list) and all(isinstance(block, dict) for block in blocks)):
        raise SamplingError(f"{where}: grid is unusable - got {blocks!r}, expected tables; write [[grid]]")
    spec = str(path.parent / given["file"])
    declared = load_declared(spec)
    seeds = _seeds(given.get("seeds", 1), where)
    defaults = {name: value for name, value in given.items() if name not in OWN}
    cases, others = [], runners or {}
    for combined in grid(blocks, defaults):
        label = str(combined.pop("label", ""))
        if (runner := others.get(str(combined.get("controller")))) is not None:
            cases += _brought(runner, declared, combined, label, seeds, where, path.parent)
            continue
        settings = complete(declared, combined, where, path.parent)
        made_from = {"file": source_digest(declared.path)}
        if settings["value"] is not None:
            made_from["value"] = content_digest(Path(settings["value"]))
            settings["value"] = os.path.relpath(settings["value"], path.parent)  # the same in every folder
        label = label or declared.controllers[settings["controller"]].title
        cases += [Case(label, settings, seed, made_from) for seed in seeds]
    if not cases:
        raise SamplingError(
            f"{where}: has no episodes - got an empty list, expected values to combine; correct the list"
        )
    series = _series(given.get("series", {}), where)
    sampled = [case for case in cases if case.settings["controller"] not in others]
    if series and not sampled:
        raise SamplingError(
            f"{where}: series is unusable - got {given['series']!r} and only controllers whose states are not kept, "
            "expected a sampling controller, too; remove series"
        )
    _try_out(declared, sampled, series, where)
    return StudyFile(path, spec, declared, tuple(cases), series, others)


def _brought(
    runner: Runner, declared: Declared, given: Mapping[str, Any], label: str, seeds: list[int], where: str, folder: Path
) -> list[Case]:
    """Return the cases of a cell whose controller sampling does not know."""
    own = {name: value for name, value in given.items() if name != "controller"}
    settings = {"controller": given["controller"], **runner.complete(own, where, folder)}
    made_from = {"file": source_digest(declared.path)}
    for name, path in runner.files(settings, folder).items():
        made_from[name] = content_digest(path)
    return [Case(label or runner.title, settings, seed, made_from) for seed in seeds]


def try_controllers(study: StudyFile) -> None:
    """Make the controller of every cell once, which also compiles what is not in the cache.

    Raises:
        PiaffeError: a controller cannot be made, or its value was learnt for something else.
    """
    for case in {case.cell: case for case in study.cases}.values():
        runner = study.runners.get(case.settings["controller"])
        if runner is not None:
            runner.prepare(study.spec, case.settings, study.path.parent)
            continue
        prepare(study.declared, located(case.settings, study.path.parent)).close()


def _try_out(declared: Declared, cases: list[Case], series: Mapping[str, float], where: str) -> None:
    """Make the problem and the plant of every cell once, so that their errors are raised now."""
    tried: set[str] = set()
    for case in cases:
        options_of(declared, case.settings)
        own = {name: case.settings[name] for name in declared.settings if name != "horizon"}
        own |= {name: case.settings[name] for name in ("horizon", "plant_timestep", "friction", "payload")}
        if repr(own) not in tried:
            problem = declared.problem({k: v for k, v in own.items() if k in declared.settings and k != "horizon"},
                                       case.settings["horizon"])  # fmt: skip
            model = problem.schedule.segments[0].model
            plant_of(model, case.settings)
            tried.add(repr(own))
            for name in series:
                joints: tuple[str, ...] = getattr(model, "robot").joint_names  # noqa: B009  # a models.Mujoco
                if name != "height" and not any(name in joint for joint in joints):
                    raise UnknownNameError(f"{where}, series", "joint", name, ["height", *joints])


def _seeds(given: Any, where: str) -> list[int]:
    seeds = list(range(given)) if isinstance(given, int) and not isinstance(given, bool) else given
    whole = isinstance(seeds, list) and all(isinstance(s, int) and not isinstance(s, bool) and s >= 0 for s in seeds)
    if not (whole and seeds):
        raise SamplingError(
            f"{where}: seeds are unusable - got {given!r}, expected a number of seeds, or a list of whole numbers; "
            "write seeds = 20"
        )
    return list(dict.fromkeys(seeds))


def _series(given: Any, where: str) -> dict[str, float]:
    if isinstance(given, dict) and all(isinstance(limit, int | float) for limit in given.values()):
        return {name: float(limit) for name, limit in given.items()}
    raise SamplingError(
        f"{where}: series is unusable - got {given!r}, expected limits by name: part of joints' names, or "
        "height; correct it"
    )


def source_digest(path: Path) -> str:
    """Return a digest of Python code; comments and layout have no effect on it."""
    tree = ast.dump(ast.parse(path.read_text(encoding="utf-8")))
    return hashlib.sha256(tree.encode()).hexdigest()[:16]


def content_digest(path: Path) -> str:
    """Return a digest of a file, or of all files in a folder."""
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            digest.update(str(file.relative_to(path)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]
