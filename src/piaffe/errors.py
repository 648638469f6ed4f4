"""Errors of Piaffe. Their messages have the form *where: what is wrong - got, expected; what to do*."""

from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from typing import Any, Never, Self


class PiaffeError(Exception):
    """Base class of all errors of Piaffe."""


class ProblemError(PiaffeError, ValueError):
    """A declaration is inconsistent: a phase, a schedule, an objective or a constraint."""


class ShapeError(ProblemError):
    """An array has the wrong number of entries."""


class ModelError(PiaffeError, ValueError):
    """A robot or a model cannot be built, or does not have what was requested."""


class UnknownNameError(ModelError, KeyError):
    """A name is not among the known ones; the message lists the most similar ones.

    Args:
        where: the object without this name, e.g. ``"robot 'go2'"``.
        what: the kind of object with the name, e.g. ``"frame"``.
        name: the unknown name.
        known: the names that exist.
        advice: what to do, if no name is very similar; by default, similar names.
    """

    def __init__(self, where: str, what: str, name: str, known: Iterable[str], advice: str = "") -> None:
        self.where = where
        self.what = what
        self.name = name
        self.known = tuple(known)
        self.advice = advice
        close = " or ".join(map(repr, get_close_matches(name, self.known, n=3, cutoff=0.4)))
        nearest = get_close_matches(name, self.known, n=1, cutoff=0.8)
        self.hint = f" (did you mean '{nearest[0]}'?)" if nearest else ""
        similar = f"did you mean {close}?" if close else "use one of the names that exist"
        hint = advice if advice and not nearest else similar
        super().__init__(f"{where}: no {what} '{name}' - got '{name}', expected one of {list(self.known)}; {hint}")

    def __reduce__(self) -> tuple[type[Self], tuple[object, ...]]:  # processes of a study send errors to each other
        return type(self), (self.where, self.what, self.name, self.known, self.advice)

    def __str__(self) -> str:  # KeyError would print the quoted repr
        return str(self.args[0])


class FileFormatError(PiaffeError, ValueError):
    """A file has another format, is truncated, or was written by a newer version."""


class FileWriteError(PiaffeError, OSError):
    """A file cannot be written."""


class PiaffeWarning(UserWarning):
    """A declaration is usable, but it is likely not what was meant; the message has file and line."""


class SolverError(PiaffeError, RuntimeError):
    """A solver cannot do what was requested, or a solve that had to converge did not."""


class SamplingError(PiaffeError, RuntimeError):
    """A sampling controller, a roll-out or a value function cannot do what was requested."""


def renamed(module: str, names: Mapping[str, str]) -> Callable[[str], Never]:
    """Return a ``__getattr__`` for a module: for a renamed name it raises an error with the new name.

    The error is an ImportError: of an AttributeError, ``from module import name`` would not show the text.

    Args:
        module: dotted name of the module.
        names: old name → what to use now, as ``{"Batch": "piaffe.ocp.Vectorised"}``.
    """

    def __getattr__(name: str) -> Never:
        if name in names:
            raise ImportError(
                f"module '{module}': '{name}' was renamed - got '{name}', expected '{names[name]}'; use that"
            )
        raise AttributeError(f"module '{module}' has no attribute '{name}'")

    return __getattr__


def renamed_members(owner: str, names: Mapping[str, str]) -> Callable[[Any, str], Never]:
    """Return a ``__getattr__`` for a class: for a renamed attribute it raises an error with the new name.

    Args:
        owner: name of the class.
        names: old name of an attribute or a method → what to use now, as ``{"numbers": "parameters"}``.
    """

    def __getattr__(self: object, name: str) -> Never:
        if name in names:
            raise AttributeError(
                f"{owner}: '{name}' was renamed - got '{name}', expected '{names[name]}'; use that", name=name, obj=self
            )
        raise AttributeError(f"'{owner}' object has no attribute '{name}'", name=name, obj=self)

    return __getattr__
