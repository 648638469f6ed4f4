"""Problem: motion, schedule, objective, constraints and initial state, as one value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError, ShapeError

from .model import model_of
from .motion import Motion
from .schedule import Schedule
from .source import Source, caller
from .termset import Constraints, Objective
from .user_input import numbers_of

Array = NDArray[np.float64]


@dataclass(frozen=True, init=False, eq=False)
class Problem:
    """One declaration of an optimal-control problem.

    Args:
        motion: phases and targets.
        schedule: models and time steps along the horizon.
        objective: what to achieve.
        constraints: what to respect.
        initial: initial state of the first model, (nx,).
        parameters: values that replace defaults: of an ``ocp.parameter`` by name, of a model's number by
            ``"model.slot"``.
    """

    motion: Motion
    schedule: Schedule
    objective: Objective
    constraints: Constraints
    initial: Array
    parameters: Mapping[str, Array] = field(default_factory=dict)
    source: Source = field(default_factory=caller)

    def __init__(
        self,
        motion: Motion,
        schedule: Schedule,
        objective: Objective,
        constraints: Constraints | None = None,
        *,
        initial: ArrayLike,
        parameters: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        source = caller()
        kinds: tuple[tuple[str, object, type], ...] = (
            ("motion", motion, Motion),
            ("schedule", schedule, Schedule),
            ("objective", objective, Objective),
            ("constraints", constraints or Constraints(), Constraints),
        )
        for name, value, kind in kinds:
            if not isinstance(value, kind):
                raise ProblemError(
                    f"problem ({source}): {name} is unusable - got {type(value).__name__}, expected "
                    f"ocp.{kind.__name__}; make one"
                )
        for key, entry in {
            "motion": motion,
            "schedule": schedule,
            "objective": objective,
            "constraints": constraints or Constraints(),
            "initial": _initial(initial, schedule, source),
            "source": source,
            "parameters": _parameters(parameters or {}, source),
        }.items():
            object.__setattr__(self, key, entry)

    def with_parameters(self, **values: ArrayLike) -> Problem:
        """Return the problem with other values of parameters; nothing is rebuilt."""
        return self._with("parameters", {**self.parameters, **_parameters(values, self.source)})

    def with_initial(self, initial: ArrayLike) -> Problem:
        """Return the problem from another initial state."""
        return self._with("initial", _initial(initial, self.schedule, self.source))

    def with_schedule(self, schedule: Schedule) -> Problem:
        """Return the problem over another schedule, whose first model must have the same state."""
        _initial(self.initial, schedule, self.source)
        return self._with("schedule", schedule)

    def _with(self, name: str, value: object) -> Problem:
        other = object.__new__(Problem)
        other.__dict__.update(self.__dict__)
        other.__dict__[name] = value
        return other

    def __str__(self) -> str:
        from ..compiler import compile_problem
        from ..reports import describe

        return describe(compile_problem(self))


def _initial(initial: ArrayLike, schedule: Schedule, source: Source) -> Array:
    """Return an initial state of the first model, its quaternions normalised; raise if it is none."""
    head = model_of(schedule.segments[0])
    x0 = numbers_of(initial, f"problem ({source})", "initial state")
    if x0.shape != (head.state.nx,):
        layout = ", ".join(f"{b.quantity.path} {b.nx}" for b in head.state.blocks)
        raise ShapeError(
            f"problem ({source}): initial state has the wrong size for model '{head.name}' - got shape {x0.shape}, "
            f"expected ({head.state.nx},): {layout}; build it with the model's state()"
        )
    if not np.all(np.isfinite(x0)):
        bad = [int(i) for i in np.flatnonzero(~np.isfinite(x0))]
        raise ProblemError(
            f"problem ({source}): initial state is not finite - got NaN or infinity at entries {bad}, expected finite "
            "numbers; fix it"
        )
    for quantity, where in head.state.slices.items():
        if quantity.kind == "rotation" and not np.any(x0[where]):
            raise ProblemError(
                f"problem ({source}): initial state has no '{quantity}' - got a quaternion of zeros, expected one of "
                "unit length, (1, 0, 0, 0) for none; build it with the model's state()"
            )
    return head.state.np_normalise(x0)


def _parameters(values: Mapping[str, ArrayLike], source: Source) -> dict[str, Array]:
    """Return values of parameters as arrays; raise if one is no finite number."""
    where = f"problem ({source})"
    arrays = {name: numbers_of(value, where, f"parameter '{name}'").ravel() for name, value in values.items()}
    for name, array in arrays.items():
        if not np.all(np.isfinite(array)):
            raise ProblemError(
                f"{where}, parameter '{name}': is not finite - got {array.tolist()}, expected finite numbers; fix it"
            )
    return arrays
