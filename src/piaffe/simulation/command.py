"""Commands to a planner during an episode, and their text form."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from piaffe.errors import ModelError

from .numbers import finite_number

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TEXT = re.compile(rf"(?P<name>[A-Za-z_]\w*)=(?P<value>{_NUMBER}|[A-Za-z_]\w*)(?:@(?P<time>{_NUMBER}))?")
_SHORT = {"vx": "speed", "vy": "lateral_speed", "yaw": "yaw_rate"}


@dataclass(frozen=True)
class Command:
    """Values that a planner is told at a time, as ``Command(3.0, {"speed": 0.8, "yaw_rate": 0.5})``.

    ``speed`` and ``lateral_speed`` are the base's velocity ahead and to the left in heading axes [m/s], ``yaw_rate`` is
    [rad/s]. The figures of an episode compare with these. Other names go to the planner, too. ``motion`` is the name of
    a motion, which ``solvers.Motions`` begins where contacts allow.

    Args:
        time: since the motion's start [s]; it counts from the first plan at this time or later.
        values: by name.

    Raises:
        ModelError: a number is out of range, or there is no value.
    """

    time: float
    values: Mapping[str, float | str]

    def __post_init__(self) -> None:
        if finite_number("command", "time", self.time) < 0:
            raise ModelError(f"command: time is out of range - got {self.time!r}, expected seconds ≥ 0; change it")
        if not self.values:
            raise ModelError("command: no values - got none, expected at least one, as {'speed': 0.5}; give one")
        for name, value in self.values.items():
            where = f"command at {self.time:g} s"
            if name != "motion":
                finite_number(where, f"'{name}'", value)
            elif not (isinstance(value, str) and value.isidentifier()):
                raise ModelError(f"{where}: 'motion' is no name - got {value!r}, expected that of a motion; change it")


def parse_commands(texts: str | Iterable[str]) -> tuple[Command, ...]:
    """Return the commands of a text, in the order of time: ``"vx=0.5 vx=0.8@3 yaw=0.5@6 motion=pace@7"``.

    A value without ``@`` counts from 0 s on. ``vx``, ``vy`` and ``yaw`` are short for ``speed``, ``lateral_speed`` and
    ``yaw_rate``. The value of ``motion`` is a name.

    Raises:
        ModelError: a text is not a command, or a name has two values at one time.
    """
    at: dict[float, dict[str, float | str]] = {}
    for word in [word for text in ([texts] if isinstance(texts, str) else texts) for word in text.split()]:
        found = _TEXT.fullmatch(word)
        if found is None or (found["name"] == "motion") != found["value"].isidentifier():
            raise ModelError(
                f"command: text is unusable - got {word!r}, expected name=value@time, as 'vx=0.5@3'; fix it"
            )
        name, values = _SHORT.get(found["name"], found["name"]), at.setdefault(float(found["time"] or 0.0), {})
        if name in values:
            raise ModelError(
                f"command: '{name}' has two values at one time - got {_shown(values[name])} and {found['value']}, "
                "expected one; remove one"
            )
        values[name] = found["value"] if name == "motion" else float(found["value"])
    return tuple(Command(time, values) for time, values in sorted(at.items()))


def _shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"
