"""Checks of a user's numbers and calls of a user's functions; errors name the declaration, its file and its line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import PiaffeError, ProblemError

Array = NDArray[np.float64]


def numbers_of(value: Any, where: str, what: str) -> Array:
    """Return a user's numbers as an array of at least one dimension.

    Args:
        value: the user's numbers.
        where: the declaration, for the message.
        what: which entry of the declaration, for the message.

    Raises:
        ProblemError: the value is neither a number nor an array of numbers.
    """
    if isinstance(value, cs.SX | cs.MX):
        got = f"the symbol '{value}'" if value.is_scalar() and value.is_symbolic() else "a CasADi expression"
        raise ProblemError(
            f"{where}: {what} is unusable - got {got}, expected numbers; give numbers: they can change without a new "
            "compilation, as an ocp.parameter can"
        )
    try:
        return np.atleast_1d(np.asarray(value, dtype=float))
    except (TypeError, ValueError) as error:
        raise ProblemError(f"{where}: {what} is unusable - got {value!r}, expected numbers; give some") from error


def brief(value: object) -> str:
    """Return a short description of a user's value, for a message."""
    text = repr(value)
    return text if len(text) < 40 else type(value).__name__


def call(function: Callable[..., Any], where: str, *arguments: Any, **named: Any) -> Any:
    """Return the result of a user's function; an error in it names the declaration and the line that failed.

    Args:
        function: the function.
        where: the declaration of the function, for the message.
        arguments: its arguments.
        named: its keyword arguments.

    Raises:
        ProblemError: the function fails.
    """
    try:
        return function(*arguments, **named)
    except PiaffeError:
        raise
    except Exception as error:
        text = " ".join(str(error).split())
        raise ProblemError(
            f"{where}: the function fails{_line(error)} - got {type(error).__name__}: {text}, expected an expression "
            "made with CasADi's functions; fix it"
        ) from error


def _line(error: Exception) -> str:
    """Return `` at FILE:LINE`` of the innermost line outside Piaffe and installed packages; empty if there is none."""
    line, trace = "", error.__traceback__
    while trace is not None:
        code, module = trace.tb_frame.f_code, trace.tb_frame.f_globals.get("__name__", "")
        if not module.startswith("piaffe.") and "site-packages" not in code.co_filename:
            line = f" at {Path(code.co_filename).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return line
