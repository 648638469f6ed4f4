"""From settings to closed loops: a controller and a plant, made from the declarations of a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from piaffe.errors import FileFormatError, SamplingError, UnknownNameError
from piaffe.simulation import Episode, Progress, Spread, run_episode

from ..controllers import Sampler
from ..options import Options
from .declared import Declared

NO_VALUE = "none"
RUN: Mapping[str, Any] = {
    "controller": "td-cd", "value": None, "allow": "", "horizon": None, "steps": 400, "spread": {},
    "latency": 0.0, "payload": 0.0, "friction": None, "plant_timestep": 0.002,
}  # fmt: skip
"""Settings of a run and their defaults. For ``value``, None is the value in the file, and ``"none"`` is no value.
``allow`` lists the entries in which the problem may differ from the one that the value was learnt for, as
``"terrain payload"``."""

OPTIONS = tuple(field.name for field in fields(Options) if field.name not in ("seed", "threads"))
"""Settings of a controller."""

_ELSEWHERE = {"seed": "--seed, --seeds, or a study's seeds", "threads": "--threads, or a study's --workers"}


@dataclass(frozen=True)
class Trial:
    """A controller and a plant, which can be run with any seed.

    Args:
        controller: the controller.
        plant: the simulated robot that it controls.
        settings: all settings of the run.
        spread: distribution of the initial states.
    """

    controller: Sampler
    plant: Any
    settings: Mapping[str, Any]
    spread: Spread

    def run(self, seed: int, progress: Progress | None = None) -> Episode:
        """Return the episode of a seed, which determines the perturbations and the initial state."""
        initial = self.spread.around(self.controller.model, self.controller.problem.initial, seed)
        return run_episode(
            self.controller, self.plant, steps=self.settings["steps"], seed=seed, initial=initial,
            latency=self.settings["latency"], progress=progress,
        )  # fmt: skip

    def close(self) -> None:
        """Release threads and memory."""
        self.controller.engine.close()


def known_settings(declared: Declared) -> tuple[str, ...]:
    """Return the names of all settings: of runs, of controllers, and of the file's function.

    Raises:
        SamplingError: an argument of the function has the name of another setting.
    """
    clash = sorted((set(RUN) | set(OPTIONS) | {"seed", "label"}) & set(declared.settings) - {"horizon"})
    if clash:
        raise SamplingError(
            f"file '{declared.path}', function '{declared.name}': argument '{clash[0]}' has the name of a setting of "
            "Piaffe - got one name for two settings, expected another; rename the argument"
        )
    return tuple(dict.fromkeys((*RUN, *OPTIONS, *declared.settings)))


def complete(declared: Declared, given: Mapping[str, Any], where: str, folder: Path = Path()) -> dict[str, Any]:
    """Return settings completed with all defaults; raise an error if one is unknown or out of range.

    Args:
        declared: declarations of the file.
        given: settings by name.
        where: start of error messages.
        folder: folder that the path of a value in ``given`` is relative to.

    Raises:
        UnknownNameError: a setting or a controller is unknown.
        SamplingError: a setting is out of range.
        FileFormatError: the value's file is missing.
    """
    known = known_settings(declared)
    for name in given:
        if name in _ELSEWHERE:
            raise SamplingError(
                f"{where}: '{name}' is no setting - got {given[name]!r}, expected {_ELSEWHERE[name]}; give it there"
            )
        if name not in known:
            raise UnknownNameError(where, "setting", name, known)
    settings = {**RUN, **given}
    kind = settings["controller"]
    if kind not in declared.controllers:
        raise UnknownNameError(where, "controller", str(kind), declared.controllers)
    for name in ("steps", "horizon"):
        value = settings[name]
        if not (value is None and name == "horizon") and (isinstance(value, bool) or not _whole(value)):
            raise SamplingError(
                f"{where}: {name} is out of range - got {value!r}, expected a whole number, at least 1; change it"
            )
    for name, least in {"latency": 0.0, "payload": 0.0, "friction": 0.0, "plant_timestep": 1e-5}.items():
        value = settings[name]
        if value is None and name == "friction":
            continue
        if isinstance(value, bool) or not (isinstance(value, int | float) and value >= least):
            raise SamplingError(
                f"{where}: {name} is out of range - got {value!r}, expected a number, at least {least:g}; change it"
            )
    if not isinstance(settings["allow"], str):
        raise SamplingError(
            f"{where}: allow is unusable - got {settings['allow']!r}, expected names, as 'terrain payload'; correct it"
        )
    spread_of(settings, where)
    options_of(declared, settings)
    settings["value"] = value_of(declared, settings, where, folder)
    return {**settings, **{name: given.get(name, default) for name, default in declared.settings.items()
                           if name != "horizon"}}  # fmt: skip


def options_of(declared: Declared, settings: Mapping[str, Any], threads: int | None = None) -> Options:
    """Return a controller's options: the defaults of its class, changed by those of the file, changed by settings."""
    kind = settings["controller"]
    if isinstance(declared.options, Mapping):
        for name in declared.options:
            if name not in declared.controllers:
                raise UnknownNameError(
                    f"file '{declared.path}', options", "controller", str(name), declared.controllers
                )
    changed: Any = declared.options if isinstance(declared.options, Options) else declared.options.get(kind, {})
    if isinstance(changed, Options):  # only options that differ from the defaults of Options replace the controller's
        usual = Options()
        changed = {name: getattr(changed, name) for name in OPTIONS if getattr(changed, name) != getattr(usual, name)}
    own = {name: settings[name] for name in OPTIONS if name in settings}
    try:
        options = replace(declared.controllers[kind].defaults, **changed)
    except TypeError as error:
        raise SamplingError(
            f"file '{declared.path}', options of '{kind}': cannot be used - got {error}, expected a sampling.Options "
            f"or a dictionary of {list(OPTIONS)}; correct them"
        ) from error
    return replace(options, threads=threads, **own)


def spread_of(settings: Mapping[str, Any], where: str) -> Spread:
    """Return the spread of initial states: ``True`` for the default, ``False`` for none, or deviations by name."""
    given = settings["spread"]
    names = [field.name for field in fields(Spread)]
    if isinstance(given, bool):
        given = {} if given else dict.fromkeys(names, 0.0)
    if not isinstance(given, Mapping):
        raise SamplingError(
            f"{where}: spread is unusable - got {given!r}, expected true, false or deviations by name: {names}; "
            "correct it"
        )
    for name in given:
        if name not in names:
            raise UnknownNameError(where, "deviation of initial states", name, names)
    return Spread(**given)


def value_of(declared: Declared, settings: Mapping[str, Any], where: str, folder: Path) -> str | None:
    """Return the absolute path of a value; None without a value, and for controllers that use none.

    Raises:
        FileFormatError: there is no such file.
        SamplingError: the settings have a value, but the controller uses none.
    """
    kind, given = settings["controller"], settings["value"]
    if given == NO_VALUE or (given is None and declared.value is None):
        return None
    if not declared.controllers[kind].uses_value:
        if given is None:
            return None
        users = [name for name, controller in declared.controllers.items() if controller.uses_value]
        raise SamplingError(
            f"{where}: controller '{kind}' uses no value - got '{given}', expected '{NO_VALUE}' or controller "
            f"{' or '.join(map(repr, users))}; change one of them"
        )
    chosen, home = (declared.value, declared.path.parent) if given is None else (given, folder)
    path = (home / str(chosen)).resolve()
    if not path.exists():
        raise FileFormatError(
            f"{where}: value '{path}' is not there - got no file, expected a file written by Value.save; train "
            f"one, or pass '{NO_VALUE}'"
        )
    return str(path)


def located(settings: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return settings with the absolute path of the value, which is relative to a folder in the given settings."""
    value = settings["value"]
    return {**settings, "value": None if value is None else str((folder / value).resolve())}


def prepare(declared: Declared, settings: Mapping[str, Any], threads: int | None = None) -> Trial:
    """Return a controller and a plant.

    Args:
        declared: declarations of the file.
        settings: settings returned by :func:`complete`.
        threads: number of threads of roll-outs and evaluation.

    Raises:
        PiaffeError: the problem, the controller or the plant cannot be made.
    """
    own = {name: settings[name] for name in declared.settings if name in settings and name != "horizon"}
    problem = declared.problem(own, settings["horizon"])
    kind = declared.controllers[settings["controller"]]
    allow = settings["allow"].replace(",", " ").split()
    extra = {"value": settings["value"], "allow": allow} if kind.uses_value else {}
    controller = kind(problem, options_of(declared, settings, threads), reward=declared.reward, **extra)
    try:
        controller.initial_memory()  # raises errors of options now, not in the first plan
        return Trial(controller, plant_of(controller.model, settings), settings, spread_of(settings, "settings"))
    except BaseException:
        controller.engine.close()
        raise


def plant_of(model: Any, settings: Mapping[str, Any]) -> Any:
    """Return the plant: the model with a smaller step, and with the changes that the controller does not model."""
    from piaffe.models import payload

    changes: dict[str, Any] = {}
    if settings["payload"]:
        changes["payload"] = payload(settings["payload"])
    if settings["friction"] is not None:
        changes["friction"] = settings["friction"]
    return model.as_plant(timestep=settings["plant_timestep"], **changes)


def _whole(value: Any) -> bool:
    return isinstance(value, int) and value >= 1
