"""Several motions in one controller: a planner for each, and changes between them where contacts allow."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import PiaffeError, ProblemError, SolverError, UnknownNameError
from piaffe.ocp import Horizon, Problem

from ..tracking import LowLevel
from .changes import Changes
from .code import HorizonCode
from .loop import Loop, time_goes_back
from .memory import RecedingMemory
from .motions_tick import MotionsMemory, MotionsTick
from .numpy_motions import NumpyMotions
from .plan import Plan
from .receding_horizon import RecedingHorizon, check_latency

Array = NDArray[np.float64]


class Motions:
    """Plans one of several motions again and again, from measured states; a command asks for another motion.

    Each motion has a planner as :class:`RecedingHorizon`. One is active. ``command(motion="pace")`` asks for another
    one. It takes over at the first start of a phase at which contacts allow: the feet of its first phase stand there
    before, or land there. If they never do, a motion whose only piece is endless begins with another phase of its
    cycle. A motion with an end is finished first; then follows the motion that is asked for, else the one of ``after``,
    else the last one without an end.

    A motion begins where the robot is, at the state that the plan before predicts, with the commands that it knows. Its
    first plans are made ahead of the change and do not act; they have as many iterations as any plan. So while a change
    is prepared, a plan takes up to twice as long. Only the first plan of all is solved until no step helps.

    Args:
        problems: the declarations by name. The first models are of one robot.
        start: the first motion; by default the first one of ``problems``.
        after: per motion with an end, the motion that follows it, if no other is asked for.
        changes: pairs (from, to) of motions that may follow each other; by default all. A request for another pair
            waits until a motion is active from which it is possible.
        preparations: plans that are made ahead of a change at least; a change to which there is less time waits for the
            next boundary. The end of a motion does not wait.
        options: arguments of :class:`RecedingHorizon`, the same for all motions.

    ``warnings`` has the likely mistakes of all problems, which are issued as ``PiaffeWarning``.

    Raises:
        ProblemError: a problem does not compile; the first models have other states or controls; a motion that may
            follow another one never can; or no motion follows the end of one.
        UnknownNameError: there is no motion of a name.
        SolverError: an argument is out of range.
        NoCompilerError: the backend is native, and no compiler works.
    """

    def __init__(
        self,
        problems: Mapping[str, Problem],
        *,
        start: str | None = None,
        after: Mapping[str, str] | None = None,
        changes: Collection[tuple[str, str]] | None = None,
        preparations: int = 3,
        **options: Any,
    ) -> None:
        self.problems = checked_problems(problems)
        self._names = names = list(problems)
        first = self._index(names[0] if start is None else start, "start")
        for name, other in (after or {}).items():
            self._index(name, "after"), self._index(other, f"after '{name}'")
        for pair in changes or ():
            for name in pair:
                self._index(name, "changes")
        if not (isinstance(preparations, int | np.integer) and preparations >= 0):
            raise SolverError(
                f"motions: preparations is out of range - got {preparations!r}, expected a whole number ≥ 0; change it"
            )
        backend = options.pop("backend", "native")
        readable = [_planner(name, problem, options) for name, problem in self.problems.items()]
        self.horizons: dict[str, Horizon] = {n: each.horizon for n, each in zip(names, readable, strict=True)}
        """The problems at any time, by name."""
        self.warnings = tuple(each for planner in readable for each in planner.warnings)
        _check_models(self.horizons)
        head = readable[first]
        self.period, self.iterations, self.latency = head.period, head.iterations, head.latency
        self.first_iterations, self.options, self.backend = head.first_iterations, head.options, backend
        self.start = names[first]
        table = Changes(self.horizons, changes)
        ends = dict(after or {})
        following = [names.index(ends[n]) if n in ends else -1 for n in names]
        home = self._home(first, following, table)
        self._numpy = self._native = None
        if backend == "native":
            code = HorizonCode([each.horizon for each in readable], more=1)
            memories = [
                RecedingMemory(
                    each.horizon, each.options, each.latency, each.iterations, each.first_iterations,
                    options.get("retiming"), each.readable.adapt_below, code, number,
                )
                for number, each in enumerate(readable)
            ]  # fmt: skip
            memory = MotionsMemory(memories, table, following, home, preparations, self.period)
            self._native = MotionsTick(memory, names, first)
        else:
            RecedingHorizon(self.problems[self.start], **options, backend=backend)  # refuses unknown ones
            self._numpy = NumpyMotions(
                names, [each.readable for each in readable], table, following, start=first, home=home,
                preparations=preparations, period=self.period, latency=self.latency, iterations=self.iterations,
                first_iterations=self.first_iterations,
            )  # fmt: skip
        self._commands: dict[str, float] = {}
        self._last_start: float | None = None

    # ---- what is known

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the motions."""
        return tuple(self._names)

    @property
    def initial(self) -> Array:
        """Initial state of the first motion's problem (nx,)."""
        return self.problems[self.start].initial

    @property
    def active(self) -> str:
        """The motion of the last plan; the first motion before there is one."""
        found = self._native or self._numpy
        assert found is not None  # one of both makes the plans
        return self._names[found.active]

    @property
    def compiled(self) -> MotionsTick | None:
        """The plans in C; None for the readable reference."""
        return self._native

    def velocity(self, t: float) -> Array:
        """Return the velocity ahead, to the left [m/s], and yaw rate [rad/s] that the active motion is told, (3,)."""
        known = self.horizons[self.active].commands
        known |= {name: value for name, value in self._commands.items() if name in known}
        return np.array([known.get(name, 0.0) for name in ("speed", "lateral_speed", "yaw_rate")])

    # ---- commands and plans

    def checked_commands(self, values: Mapping[str, float | str]) -> dict[str, float]:
        """Return commands as numbers; ``motion`` becomes the index of the motion.

        Raises:
            UnknownNameError: no motion has such a command, or there is no such motion.
            ProblemError: a value is not finite.
        """
        known = {name: value for each in self.horizons.values() for name, value in each.commands.items()}
        found: dict[str, float] = {}
        for name, value in values.items():
            if name == "motion":
                found[name] = self._index(str(value), "command")
                continue
            if name not in known:
                raise UnknownNameError("motions", "command", name, ["motion", *known])
            own = next(each for each in self.horizons.values() if name in each.commands)
            found |= own.checked_commands({name: value})  # type: ignore[dict-item]  # it refuses what is no number
        return found

    def command(self, *, motion: str | None = None, **values: float) -> None:
        """Ask for a motion, and set commands of all motions that know them, from the next plan on.

        A request counts until its motion begins, or the next request. To ask for the active motion takes it back.

        Raises:
            UnknownNameError: no motion has such a command, or there is no such motion.
            ProblemError: a value is not finite.
        """
        given: dict[str, float | str] = dict(values)
        found = self.checked_commands(given if motion is None else {**given, "motion": motion})
        index = found.pop("motion", None)
        self._commands |= found
        if self._native is not None:
            self._native.tell(self._commands)
        if index is not None:
            made: Any = self._native or self._numpy
            made.ask_for(int(index))

    def reset(self) -> None:
        """Delete all plans, commands and requests; the first motion is active.

        Raises:
            SolverError: a loop makes the plans.
        """
        made: Any = self._native or self._numpy
        made.reset()
        self._commands, self._last_start = {}, None
        if self._native is not None:
            self._native.tell({})

    def plan(self, x: ArrayLike, t: float) -> Plan:
        """Return a plan from a state (nx,) that was measured at time t [s]; see :meth:`RecedingHorizon.plan`.

        Raises:
            ProblemError: the state is not finite, or the plan would begin outside the motion.
            ShapeError: the state has another size.
            SolverError: a loop makes the plans.
        """
        horizon = self.horizons[self.active]
        state = horizon.checked(x)
        if not abs(t) < horizon.latest:  # not NaN either
            raise horizon.outside(t)
        last = self._last_start if self._native is None else self._native.last_start
        if last is not None and t + self.latency <= last - self.period:
            raise time_goes_back(t, last)
        made: Any = self._native or self._numpy
        plan: Plan = made(state, t, self._commands)
        self._last_start = plan.start
        return plan

    def running(self, low: LowLevel, *, thread: bool = True, latency: float | None = None) -> Loop:
        """Return a loop of these motions and a low level, which the caller starts; see :meth:`RecedingHorizon.running`.

        Raises:
            SolverError: motions or low level are not compiled, the low level is not for plans of these motions, or the
                latency is zero, so that there is no time for plans in a thread, or more than the period.
        """
        if latency is not None:
            check_latency(latency, self.period)
        return Loop(self._native, low, self.period, max(self.latency, latency or 0.0), thread=thread)

    # ---- checks

    def _index(self, name: str, where: str) -> int:
        if name not in self._names:
            raise UnknownNameError(f"motions, {where}", "motion", name, self._names)
        return self._names.index(name)

    def _home(self, first: int, following: list[int], table: Changes) -> int:
        """Return the motion that counts as the last one without an end; raise unless a motion follows each end."""
        endless = [i for i, n in enumerate(self._names) if self.horizons[n].calendar.cycle]
        for i, name in enumerate(self._names):
            if i in endless:
                continue
            wanted = [following[i]] if following[i] >= 0 else endless
            missing = [self._names[j] for j in wanted if table.entries[i][-1, j] < 0]
            if not wanted or missing:
                got = f"no change to {', '.join(missing)}" if missing else "no motion without an end"
                raise ProblemError(
                    f"motions: nothing follows the end of '{name}' - got {got}, expected a motion to which it may "
                    f"change; name one: after={{'{name}': ...}}, and allow the change"
                )
        return first if first in endless or not endless else endless[0]


def checked_problems(problems: Mapping[str, Problem]) -> dict[str, Problem]:
    """Return declarations by name.

    Raises:
        ProblemError: there is none, a name is no identifier, or one is no problem.
    """
    for name, problem in problems.items():
        if not (isinstance(name, str) and name.isidentifier() and name == name.lower()):
            raise ProblemError(
                f"motions: a name is unusable - got {name!r}, expected small letters, digits and underscores, as "
                "'trot'; change it"
            )
        if not isinstance(problem, Problem):
            raise ProblemError(
                f"motions, '{name}': is not a problem - got {type(problem).__name__}, expected an ocp.Problem; give one"
            )
    if not problems:
        raise ProblemError("motions: there is none - got an empty mapping, expected problems by name; give one")
    return dict(problems)


def _planner(name: str, problem: Problem, options: Mapping[str, Any]) -> RecedingHorizon:
    """Return the readable planner of a motion; errors name the motion."""
    try:
        return RecedingHorizon(problem, **options, backend="numpy")
    except PiaffeError as error:
        error.args = (f"motion '{name}': {error}", *error.args[1:])
        raise


def _check_models(horizons: Mapping[str, Horizon]) -> None:
    """Raise unless all first models have the same states and controls."""
    first, *others = horizons
    head = _layout(horizons[first])
    for name in others:
        own = _layout(horizons[name])
        for what, expected, got in zip(("states", "controls", "robot"), head, own, strict=True):
            if expected != got:
                raise ProblemError(
                    f"motions: '{first}' and '{name}' do not fit - got other {what} of the first models, '"
                    f"{horizons[first].models[0].name}' and '{horizons[name].models[0].name}', expected the same; "
                    "declare both motions for one robot"
                )


def _layout(horizon: Horizon) -> tuple[Any, ...]:
    model = horizon.models[0]
    labels = [[(block.quantity.path, block.labels) for block in space.blocks] for space in (model.state, model.control)]
    return labels[0], labels[1], getattr(getattr(model, "robot", None), "name", None)
