"""Read a problem from a Python file."""

from __future__ import annotations

import importlib.util
import re
import sys
import traceback
from collections.abc import Mapping
from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from piaffe.errors import PiaffeError, ProblemError, UnknownNameError

from .calls import arguments_of_call

if TYPE_CHECKING:
    from .problem import Problem


def load_problem(spec: str, *, quiet: bool = False) -> Problem:
    """Return the problem of ``FILE`` or ``FILE:name``: an object of that name, or a function that returns one.

    Args:
        spec: a Python file, and after a colon the name; the default name is ``problem``.
        quiet: send the output of the file to standard error, so that standard output has only the command's output.

    Raises:
        ProblemError: there is no such file, it does not run, or the object of that name is not a problem.
    """
    return load_problem_file(spec, quiet=quiet)[0]


def load_problem_file(spec: str, *, quiet: bool = False) -> tuple[Problem, ModuleType]:
    """Return the problem of ``FILE`` or ``FILE:name`` and the file as a module; see :func:`load_problem`."""
    from .problem import Problem

    with redirect_stdout(sys.stderr) if quiet else nullcontext():
        path, name = split_spec(spec)
        module = run_file(path)
        found = _object(path, name, module)
        if not isinstance(found, Problem):
            raise _no_problem(path, name, found, "an ocp.Problem or a function that returns one")
        return found, module


def load_problems_file(spec: str, *, quiet: bool = False) -> tuple[Problem | dict[str, Problem], ModuleType]:
    """Return the problem, or the problems by name, of ``FILE`` or ``FILE:name``, and the file as a module.

    Several problems are a dict of problems, or a function that returns one; else as :func:`load_problem`.
    """
    from .problem import Problem

    with redirect_stdout(sys.stderr) if quiet else nullcontext():
        path, name = split_spec(spec)
        module = run_file(path)
        found = _object(path, name, module)
        if isinstance(found, Problem):
            return found, module
        if isinstance(found, Mapping) and found and all(isinstance(each, Problem) for each in found.values()):
            return {str(key): each for key, each in found.items()}, module
        raise _no_problem(path, name, found, "an ocp.Problem, a dict of them by name, or a function that returns one")


def _no_problem(path: Path, name: str, found: object, expected: str) -> ProblemError:
    several = isinstance(found, Mapping)
    more = "; piaffe mpc and piaffe export take several problems" if several else ""
    return ProblemError(
        f"file '{path}', name '{name}': is not a problem - got {type(found).__name__}, expected {expected}; choose "
        f"another name with FILE:name{more}"
    )


def _object(path: Path, name: str, module: ModuleType) -> object:
    """Return the object of a name, or what it returns if it is a function."""
    if not hasattr(module, name):
        raise UnknownNameError(f"file '{path}'", "problem", name, problem_names(module))
    found: object = getattr(module, name)
    if callable(found):
        try:
            found = found()
        except PiaffeError as error:
            _add_line(path, error)
            raise
        except Exception as error:
            raise file_error(path, error) from error
    return found


def problem_names(module: ModuleType) -> list[str]:
    """Return the names that may be problems: problems, then objects that the file defines; all names if none are."""
    from .problem import Problem

    names = {key: value for key, value in vars(module).items() if not key.startswith("_")}
    problems = [key for key, value in names.items() if isinstance(value, Problem)]
    own = [key for key, value in names.items() if getattr(value, "__module__", "") == module.__name__]
    return list(dict.fromkeys(problems + own)) or list(names)


def split_spec(spec: str) -> tuple[Path, str]:
    """Return file and name of ``FILE[:name]``."""
    path, colon, name = spec.rpartition(":")
    if colon and name.isidentifier():
        return Path(path), name
    return Path(spec), "problem"


def run_file(path: Path) -> ModuleType:
    """Return a Python file as a module; it can import the files in its folder, as a script can."""
    if not path.is_file():
        raise ProblemError(
            f"file '{path}': does not exist - got no file, expected a Python file with a problem; check the path"
        )
    spec = importlib.util.spec_from_file_location(f"_piaffe_file_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise ProblemError(
            f"file '{path}': is not Python - got '{path.suffix}', expected '.py'; pass the file that declares the "
            "problem"
        )
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        spec.loader.exec_module(module)
    except PiaffeError as error:
        _add_line(path, error)
        raise
    except Exception as error:
        raise file_error(path, error) from error
    except SystemExit as error:
        raise ProblemError(
            f"file '{path}': exits when imported - got sys.exit({error.code!r}), expected a problem; move the code of "
            'the script below if __name__ == "__main__":'
        ) from error
    return module


def _add_line(path: Path, error: PiaffeError) -> None:
    """Put the line of the file that led to an error of Piaffe before its text, if the text names no line."""
    line = None if re.search(r"\.py:\d", str(error)) else _line_of(path, error)
    if line:
        error.args = (f"{path.name}:{line}: {error}", *error.args[1:])


def _line_of(path: Path, error: Exception) -> int | None:
    line = error.lineno if isinstance(error, SyntaxError) and error.filename == str(path) else None
    for frame in traceback.extract_tb(error.__traceback__):
        if Path(frame.filename).resolve() == path.resolve():
            line = frame.lineno
    return line


def file_error(path: Path, error: Exception) -> ProblemError:
    """Return an error that names the line of the file that failed."""
    line = _line_of(path, error)
    where = f"{path}:{line}" if line else str(path)
    call = arguments_of_call(error)
    return ProblemError(
        f"{where}: the file does not run - got {type(error).__name__}: {error}, expected "
        f"{call or 'a declaration'}; fix it (put --traceback before the command to see all calls)"
    )
