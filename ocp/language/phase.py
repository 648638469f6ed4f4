"""Phases: parts of a motion with one mode of the dynamics."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

from piaffe.errors import ProblemError

from .sending import sendable
from .source import Source, caller
from .term import Constraint, Cost
from .termset import Constraints, Objective
from .time import SAME_TIME
from .user_input import copied, is_number


@dataclass(frozen=True)
class Free:
    """A duration for an optimiser to choose: guess, lower and upper bound [s]. Phases do not accept it yet."""

    guess: float
    lower: float
    upper: float

    def __post_init__(self) -> None:
        if not 0 < self.lower <= self.guess <= self.upper:
            raise ProblemError(
                f"Free({self.guess}, {self.lower}, {self.upper}): bounds are out of order - got guess {self.guess} s, "
                f"expected 0 < lower ≤ guess ≤ upper; reorder them"
            )


@dataclass(frozen=True, init=False)
class Keyframe:
    """Targets at the end of a phase; the path between keyframes is interpolated.

    The model defines the names. Models of robots accept ``position``, ``rpy``, ``joints``, ``linear_velocity``,
    ``angular_velocity``, ``joint_velocities``, and ``feet``, places of feet that the joints of their legs reach. Every
    model accepts the names of its own states and controls.
    """

    values: Mapping[str, Any]

    def __init__(self, **values: Any) -> None:
        object.__setattr__(self, "values", copied(values))


@dataclass(frozen=True)
class ResetMap:
    """A user's reset at the end of a phase; states that the function does not return keep their values."""

    function: Callable[..., Mapping[str, Any]]
    source: Source

    def __getstate__(self) -> dict[str, Any]:
        return sendable(self.__dict__, f"reset ({self.source})")

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        return self


def reset(function: Callable[..., Mapping[str, Any]]) -> ResetMap:
    """Return the reset map of a function of a node's quantities that returns new values of states by name."""
    return ResetMap(function, caller())


@dataclass(frozen=True, init=False, eq=False)
class Phase:
    """A part of a motion with one mode.

    Args:
        name: its name; terms and weights refer to it.
        mode: the mode, in the form of the model: ``stance("FL HR")`` for a robot, the name of a mode otherwise.
        duration: length [s], or :class:`Free`.
        target: keyframe at its end, or a mapping of targets.
        until: equality that holds at its end (a switching constraint).
        reset: reset of the state at its end, applied after the model's own.
        constraints: constraints of this phase only.
        objective: costs of this phase only, added to the problem's.
    """

    name: str
    mode: Hashable
    duration: float
    target: Keyframe | None = None
    until: tuple[Constraint, ...] = ()
    reset: ResetMap | None = None
    constraints: Constraints = field(default_factory=Constraints)
    objective: Objective = field(default_factory=Objective)
    source: Source = field(default_factory=caller)

    def __init__(
        self,
        name: str,
        mode: Hashable,
        duration: float | Free,
        target: Keyframe | Mapping[str, Any] | None = None,
        *,
        until: Constraint | Constraints | None = None,
        reset: ResetMap | None = None,
        constraints: Constraint | Constraints | None = None,
        objective: Cost | Objective | None = None,
    ) -> None:
        source = caller()
        where = f"phase '{name}' ({source})"
        if isinstance(duration, Free):
            raise ProblemError(
                f"{where}: free durations are not optimised yet - got {duration}, expected a number of seconds; "
                f"use {duration.guess}"
            )
        if not (is_number(duration) and SAME_TIME < duration < float("inf")):
            raise ProblemError(
                f"{where}: duration is out of range - got {duration!r}, expected a number of seconds above "
                f"{SAME_TIME:g}; give one"
            )
        if isinstance(target, Mapping):
            target = Keyframe(**target)
        if target is not None and not isinstance(target, Keyframe):
            raise ProblemError(
                f"{where}: target is unusable - got {target!r}, expected a Keyframe or a mapping; make one"
            )
        if not isinstance(name, str) or not name:
            raise ProblemError(f"{where}: name is unusable - got {name!r}, expected some text; give one")
        rows = _switching(until, where)
        rows = tuple(replace(row, at="phase_end") if row.at == "running" else row for row in rows)
        if reset is not None and not isinstance(reset, ResetMap):
            raise ProblemError(f"{where}: reset is unusable - got {reset!r}, expected ocp.reset(function); wrap it")
        for key, value in {
            "name": name,
            "mode": mode,
            "duration": float(duration),
            "target": target,
            "until": rows,
            "reset": reset,
            "constraints": Constraints() if constraints is None else Constraints(constraints),
            "objective": Objective() if objective is None else Objective(objective),
            "source": source,
        }.items():
            object.__setattr__(self, key, value)


def _switching(until: Constraint | Constraints | None, where: str) -> tuple[Constraint, ...]:
    """Return the switching constraints of a phase; raise if one of them is not an equality."""
    given = () if until is None else tuple(until) if isinstance(until, Constraints) else (until,)
    for row in given:
        if not isinstance(row, Constraint) or row.kind != "equality":
            got = f"the inequality '{row.name}'" if isinstance(row, Constraint) else type(row).__name__
            raise ProblemError(
                f"{where}: until is no switching constraint - got {got}, expected an ocp.equality; make one, or give "
                "an inequality with constraints="
            )
    return given
