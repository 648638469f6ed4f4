"""The declarations of a Python file for sampling: a problem, its settings, a reward, a value, controllers' options."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping
from contextlib import nullcontext, redirect_stdout
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any

from piaffe.errors import PiaffeError, ProblemError, UnknownNameError
from piaffe.ocp import Problem, file_error, problem_names, run_file, split_spec

from ..controllers import CONTROLLERS, Sampler
from ..options import Options
from ..reward import Reward

NAMES = ("sampled_problem", "problem")
"""Default names of the problem to sample: the first of these that the file has."""


@dataclass(frozen=True)
class Declared:
    """The declarations of a file for sampling.

    Args:
        path: the file.
        name: name of the problem in the file.
        make: function that returns the problem; its arguments are the file's own settings.
        settings: the file's own settings and their defaults.
        reward: the file's ``reward``; by default one of scale 1.
        value: the file's ``value``: a path, relative to the file.
        options: the file's ``options``: for all controllers, or by name of the controller.
        controllers: controllers of Piaffe and the file's ``controllers``, classes by name.
    """

    path: Path
    name: str
    make: Callable[..., Any]
    settings: Mapping[str, Any] = field(default_factory=dict)
    reward: Reward = field(default_factory=Reward)
    value: Any = None
    options: Options | Mapping[str, Any] = field(default_factory=dict)
    controllers: Mapping[str, type[Sampler]] = field(default_factory=lambda: CONTROLLERS)

    def problem(self, settings: Mapping[str, Any] | None = None, horizon: int | None = None) -> Problem:
        """Return the problem.

        Args:
            settings: arguments of the file's function.
            horizon: H in steps; the one in the file by default.

        Raises:
            ProblemError: the file's function raises an error, or its result is not a problem to sample.
        """
        given = dict(settings or {})
        if horizon is not None and "horizon" in self.settings:
            given["horizon"] = horizon
        try:
            problem = self.make(**given)
        except PiaffeError:
            raise
        except Exception as error:
            raise file_error(self.path, error) from error
        if not isinstance(problem, Problem):
            raise ProblemError(
                f"file '{self.path}', name '{self.name}': is not a problem - got {type(problem).__name__}, expected an "
                "ocp.Problem or a function that returns one; choose another name with FILE:name"
            )
        self._require_simulator(problem)
        return problem if horizon is None else with_horizon(problem, horizon)

    def _require_simulator(self, problem: Problem) -> None:
        models = [segment.model for segment in problem.schedule.segments]
        if len(models) > 1 or getattr(models[0], "has_derivatives", True):
            raise ProblemError(
                f"file '{self.path}', name '{self.name}': is not a problem to sample - got "
                f"{' + '.join(repr(model.name) for model in models)}, expected one models.Mujoco; define "
                "`sampled_problem`, or choose another name with FILE:name"
            )


def load_declared(spec: str, *, quiet: bool = False) -> Declared:
    """Return the declarations of ``FILE`` or ``FILE:name`` for sampling.

    Args:
        spec: a Python file, and after a colon the problem's name; by default the first of ``NAMES`` in the file.
        quiet: write the file's output to standard error.

    Raises:
        ProblemError: there is no such file, it raises an error, or a name in it has a value of the wrong kind.
    """
    path, name = split_spec(spec)
    with redirect_stdout(sys.stderr) if quiet else nullcontext():
        module = run_file(path)
    if not spec.endswith(f":{name}"):
        name = next((known for known in NAMES if hasattr(module, known)), name)
    if not hasattr(module, name):
        if not (known := problem_names(module)):
            raise ProblemError(
                f"file '{path}': has no problem - got no ocp.Problem, nor a function that returns one, expected "
                f"'{NAMES[0]}'; declare it"
            )
        raise UnknownNameError(f"file '{path}'", "problem", name, known)
    found = getattr(module, name)
    settings = _settings(path, name, found) if callable(found) else {}
    return Declared(
        path, name, found if callable(found) else lambda: found, settings,
        _of_kind(module, path, "reward", (Reward,), Reward()),
        getattr(module, "value", None),
        _of_kind(module, path, "options", (Options, Mapping), {}),
        {**CONTROLLERS, **_controllers(module, path)},
    )  # fmt: skip


def with_horizon(problem: Problem, steps: int) -> Problem:
    """Return a problem with another number of steps in its one segment."""
    schedule = problem.schedule
    segment = schedule.segments[0]
    return problem.with_schedule(replace(schedule, segments=(replace(segment, duration=steps * segment.dt),)))


def _settings(path: Path, name: str, make: Callable[..., Any]) -> dict[str, Any]:
    """Return the arguments of a function that makes a problem, and their defaults."""
    settings = {}
    for argument in inspect.signature(make).parameters.values():
        if argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD):
            continue
        if argument.default is argument.empty or argument.kind is argument.POSITIONAL_ONLY:
            raise ProblemError(
                f"file '{path}', function '{name}': cannot be called without arguments - got '{argument}', expected a "
                f"default, as {argument.name}=...; give it one"
            )
        settings[argument.name] = argument.default
    return settings


def _controllers(module: ModuleType, path: Path) -> dict[str, type[Sampler]]:
    """Return a file's own controllers by name."""
    found: Mapping[str, Any] = _of_kind(module, path, "controllers", (Mapping,), {})
    for name, kind in found.items():
        if not (isinstance(kind, type) and issubclass(kind, Sampler)):
            raise ProblemError(
                f"file '{path}', controllers: '{name}' is no controller - got {kind!r}, expected a subclass of "
                "sampling.Sampler; name the class, not an object of it"
            )
        if name in CONTROLLERS:
            raise ProblemError(
                f"file '{path}', controllers: '{name}' has the name of a controller of Piaffe - got {kind.__name__}, "
                f"expected another name than {list(CONTROLLERS)}; rename it"
            )
    return dict(found)


def _of_kind(module: ModuleType, path: Path, name: str, kinds: tuple[type, ...], default: Any) -> Any:
    found = getattr(module, name, default)
    if not isinstance(found, kinds):
        expected = " or ".join(kind.__name__ for kind in kinds)
        raise ProblemError(
            f"file '{path}', name '{name}': is not what controllers take - got {type(found).__name__}, expected "
            f"{expected}; rename it if it is something else"
        )
    return found
