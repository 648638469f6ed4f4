"""Cells of a study with ``controller = "mpc"``: the receding horizon of ``piaffe mpc``, with the same settings."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from piaffe.errors import ProblemError

from .online_names import names_of
from .online_output import online_row
from .online_settings import OnlineSettings, friction_text, settings_of
from .online_task import OnlineTask

MPC = "mpc"
_OWN = ("joints", "feet")  # in a study's file, `names` is the file that holds both
_FILES = ("plant", "names")
_NESTED = ("stretches", "collisions", "plan_statuses", "deadlines", "motions")  # columns of a table are no lists


class MpcRunner:
    """Runs the cells of a study whose controller is ``"mpc"``; see ``sampling.Runner``."""

    title = "MPC"

    def complete(self, given: Mapping[str, Any], where: str, folder: Path) -> dict[str, Any]:
        """Return settings completed with all defaults.

        Raises:
            UnknownNameError: a setting is unknown.
            ModelError: a setting is out of range.
            FileFormatError: a file cannot be read.
        """
        settings = _settings(given, where, folder)
        values: dict[str, Any] = {
            each.name: getattr(settings, each.name) for each in fields(OnlineSettings) if each.name not in _OWN
        }
        for name in _FILES:  # the same in every folder
            path = given.get(name)
            values[name] = None if path is None else os.path.relpath(folder / path, folder)
        return {**values, "friction": friction_text(settings.friction)}

    def files(self, settings: Mapping[str, Any], folder: Path) -> Mapping[str, Path]:
        """Return the plant's file and that of its names."""
        return {name: folder / settings[name] for name in _FILES if settings[name] is not None}

    def prepare(self, spec: str, settings: Mapping[str, Any], folder: Path) -> None:
        """Compile planner and low level, and make the plant."""
        OnlineTask(spec, self._located(settings, folder)).setup()

    def run(
        self, spec: str, settings: Mapping[str, Any], seed: int, folder: Path
    ) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        """Run an episode, and return its figures and the time steps."""
        task = OnlineTask(spec, self._located(settings, folder))
        row = online_row(seed, task(seed), task.settings)
        figures = {name: value for name, value in row.items() if name not in (*_NESTED, "seed")}
        setup = task.setup()
        dt = setup.problem.schedule.segments[0].dt
        return figures, {"period_s": setup.mpc.period, "iterations": setup.mpc.iterations, "dt_s": dt}

    def _located(self, settings: Mapping[str, Any], folder: Path) -> OnlineSettings:
        """Return the settings with the paths and names that an episode needs."""
        return _settings({name: value for name, value in settings.items() if name != "controller"}, "study", folder)


def _settings(given: Mapping[str, Any], where: str, folder: Path) -> OnlineSettings:
    values = dict(given)
    names = values.pop("names", None)
    for name, value in zip(_FILES, (values.get("plant"), names), strict=True):
        if value is not None and not (folder / str(value)).is_file():
            raise ProblemError(
                f"{where}: there is no file of {name} - got '{value}', expected a path relative to the study; fix it"
            )
    if values.get("plant") is not None:
        values["plant"] = str(folder / values["plant"])
    if names is not None:
        values |= names_of(folder / names, (), ())
    return settings_of(values, where)
