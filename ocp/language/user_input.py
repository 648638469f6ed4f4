"""Checks of a user's numbers and calls of a user's functions; errors name the declaration, its file and its line."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import RLock
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import PiaffeError, ProblemError

Array = NDArray[np.float64]


def numbers_of(value: Any, where: str, what: str) -> Array:
    """Return a copy of a user's numbers as an array of at least one dimension.

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
        return np.atleast_1d(np.array(value, dtype=float))
    except (TypeError, ValueError) as error:
        raise ProblemError(f"{where}: {what} is unusable - got {value!r}, expected numbers; give some") from error


def is_number(value: object) -> bool:
    """Return whether a value is a real number; True and False are none."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def copied(value: Any) -> Any:
    """Return a copy of a user's arrays, lists and mappings, also of those inside them; other values are returned."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, list):
        return [copied(each) for each in value]
    if isinstance(value, Mapping):
        return {key: copied(each) for key, each in value.items()}
    return value


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
        with _symbols_are_no_numbers():
            return function(*arguments, **named)
    except PiaffeError:
        raise
    except Exception as error:
        raise failed(error, where, "an expression made with CasADi's functions; fix it") from error


def failed(error: Exception, where: str, expected: str) -> ProblemError:
    """Return the error of a user's function that fails; it names the line that failed.

    Args:
        error: what the function raised.
        where: the declaration of the function.
        expected: what it should return, and what to do.
    """
    text = " ".join(str(error).split())
    if "truth value" in text:
        text = "a symbol has no truth value: use casadi.if_else in place of if, min, max, and, or, not"
    return ProblemError(
        f"{where}: the function fails{_line(error)} - got {type(error).__name__}: {text}, expected {expected}"
    )


def _line(error: Exception) -> str:
    """Return `` at FILE:LINE`` of the innermost line outside Piaffe and installed packages; empty if there is none."""
    line, trace = "", error.__traceback__
    while trace is not None:
        code, module = trace.tb_frame.f_code, trace.tb_frame.f_globals.get("__name__", "")
        if not module.startswith("piaffe.") and "site-packages" not in code.co_filename:
            line = f" at {Path(code.co_filename).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return line


_LOCK = RLock()
_DEPTH = 0


@contextmanager
def _symbols_are_no_numbers() -> Iterator[None]:
    """Let ``float(symbol)`` raise. CasADi returns NaN, and a comparison with NaN is False without a word."""
    global _DEPTH  # calls may be nested, and run in several threads
    with _LOCK:
        _DEPTH += 1
        if _DEPTH == 1:
            setattr(cs.SX, "__float__", _checked_float)  # noqa: B010  # mypy refuses the assignment of a method
    try:
        yield
    finally:
        with _LOCK:
            _DEPTH -= 1
            if _DEPTH == 0:
                setattr(cs.SX, "__float__", _FLOAT)  # noqa: B010  # the same


_FLOAT = cs.SX.__float__


def _checked_float(self: cs.SX) -> float:
    if not self.is_constant():
        raise TypeError(
            "a symbol is no number: float() and NumPy's arrays of numbers cannot hold it; use CasADi's functions"
        )
    return float(_FLOAT(self))
