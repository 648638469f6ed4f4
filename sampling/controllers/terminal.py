"""The value at the end of the horizon: a function, a value or its file, which is checked before it is used."""

from __future__ import annotations

from collections.abc import Collection
from os import PathLike

from piaffe.errors import SamplingError

from ..value import Served, Value, load_value
from .stage import TerminalValue


def terminal_value(
    value: TerminalValue | str | PathLike[str] | None, controller: Served, allow: Collection[str]
) -> TerminalValue | None:
    """Return the terminal value of a controller after a check; None without a value.

    Args:
        value: the user's argument.
        controller: the controller that uses it.
        allow: entries that may differ from those that it was learnt for.

    Raises:
        SamplingError: it was learnt for something else, or is not a value.
    """
    if isinstance(value, str | PathLike):
        return load_value(value, controller, allow=allow)
    if isinstance(value, Value):
        value.check(controller.nodes, controller.reward, controller.options, allow)
    elif not (value is None or callable(value)):
        raise SamplingError(
            f"controller: value is unusable - got {type(value).__name__}, expected a function of states, a Value, or "
            "the path of one; learn one by piaffe.sampling.train_value"
        )
    return value
