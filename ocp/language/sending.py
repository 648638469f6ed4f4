"""What another process can be sent: pickle finds functions by their names, so lambdas cannot be sent."""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Mapping
from types import FunctionType
from typing import Any

from piaffe.errors import ProblemError


def sendable(values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return an object's attributes as the state that pickle saves.

    Args:
        values: the attributes.
        where: the declaration, for the message.

    Raises:
        ProblemError: one of them cannot be pickled; the message names the function that is the reason.
    """
    for name, value in values.items():
        try:
            pickle.dumps(value)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            found = next(_functions(value), None)
            got = f"{type(value).__name__} ({error})" if found is None else _told(found)
            raise ProblemError(
                f"{where}: cannot be sent to another process - got {got} as {name}, expected a function at the top of "
                "a module that can be imported; define it there, or declare the problem in the other process"
            ) from error
    return dict(values)


def _functions(value: Any) -> Iterator[FunctionType]:
    """Yield the functions in a value that pickle does not find by their names."""
    if isinstance(value, FunctionType):
        try:
            pickle.dumps(value)
        except (pickle.PicklingError, AttributeError):
            yield value
    elif isinstance(value, Mapping):
        for each in value.values():
            yield from _functions(each)
    elif isinstance(value, tuple | list):
        for each in value:
            yield from _functions(each)
    elif hasattr(value, "__dict__"):
        yield from _functions(vars(value))


def _told(function: FunctionType) -> str:
    code = function.__code__
    what = "a lambda" if function.__name__ == "<lambda>" else f"the function '{function.__qualname__}'"
    return f"{what} of {code.co_filename}:{code.co_firstlineno}"
