"""What ``piaffe mpc`` runs: planner, low level and plant of a file, for any seed."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from piaffe.errors import ModelError, ProblemError, UnknownNameError
from piaffe.models import Fall, Robot, joints
from piaffe.models import payload as mass_on_base
from piaffe.ocp import Problem, compile_problem, is_same_time, load_problems_file
from piaffe.simulation import (
    OnlineEpisode,
    Plant,
    declared_friction,
    declared_ground,
    declared_robot,
    parse_commands,
    parse_pushes,
    run_online,
)
from piaffe.solvers import FeedforwardPD, JointPD, LowLevel, Motions, Plan, RecedingHorizon, Riccati, Vwbc

from .online_settings import OnlineSettings

_HORIZONTAL = ("base.position x", "base.position y")  # the path is free; the command is a velocity
_OWN_MODEL = "models of your own run in a program of your own, as examples/own_model_mpc.py does"


class OnlineSetup:
    """Planner, low level and plant of a file. What is wrong is refused before anything is compiled for the machine.

    Args:
        problem: the declaration, or several by name.
        options: arguments of ``RecedingHorizon``, or of ``Motions`` for several, that the file has.
        file: the file, for errors.
        settings: the settings.
        fall: the file's definition of a fall; None for the usual one.

    Raises:
        ProblemError: the file's options are unusable, or the first model has no robot with joints.
        ModelError: a number or text is unusable, or the file of the plant does not fit.
        UnknownNameError: there is no such option, joint or foot.
    """

    mpc: RecedingHorizon | Motions

    def __init__(
        self, problem: Problem | dict[str, Problem], options: Any, *, file: str, settings: OnlineSettings,
        fall: Any = None,
    ) -> None:  # fmt: skip
        self.declared, self.settings, self._planner = problem, settings, planner_of(problem)
        self.options, self.fall = _checked_options(options, self._planner, file), _checked_fall(fall, file)
        self.problem = problem if isinstance(problem, Problem) else _first_of(problem, self.options)
        """The declaration; of several the first motion's."""
        own = float(self.options.pop("latency", 0.0))
        self.latency = own if settings.latency is None else settings.latency
        self.pushes, self.commands = parse_pushes(settings.push), parse_commands(settings.command)
        _require_joints(self.problem, file)
        compiled = compile_problem(self.problem, checks=False)
        self.robot: Robot = declared_robot(compiled)
        self.ground, self.friction = declared_ground(compiled), declared_friction(compiled)
        self.variation = settings.variation
        self.reference = self._plant()
        """The plant without what seeds draw."""
        self._check_times()

    @classmethod
    def of_file(cls, file: str, settings: OnlineSettings, *, quiet: bool = False) -> OnlineSetup:
        """Return the setup of ``FILE`` or ``FILE:name``.

        Raises:
            PiaffeError: as above, or the file cannot be used.
        """
        problem, module = load_problems_file(file, quiet=quiet)
        return cls(
            problem, getattr(module, "mpc", {}), file=file, settings=settings, fall=getattr(module, "fall", None)
        )

    def _plant(self, **drawn: Any) -> Plant:
        """Return the plant with numbers that a seed draws."""
        given = self.settings
        extra: dict[str, Any] = {} if given.fixed_friction is None else {"friction": given.fixed_friction}
        extra |= {"payload": mass_on_base(given.payload)} if given.payload else {}
        extra |= drawn
        if given.plant is None:
            return Plant(self.robot, **{"friction": self.friction, "terrain": self.ground, **extra})
        return Plant.from_mjcf(given.plant, self.robot, joints=given.joints, feet=given.feet, **extra)

    def plant(self, seed: int) -> Plant:
        """Return the plant of a seed."""
        return self._plant(**self.variation.numbers(self.reference.links, seed))

    def _check_times(self) -> None:
        step = self.reference.timestep
        for name, value, least in (("latency", self.latency, 0.0), ("seconds", self.settings.seconds, step)):
            if not (least <= value < np.inf and is_same_time(round(value / step) * step, value)):
                raise ModelError(
                    f"command line: {name} is out of range - got {value:g} s, expected a multiple of the plant's time "
                    f"step {step:g} s, at least {least:g} s; change it"
                )

    def build(self, show: Callable[[str], None] = lambda what: None) -> None:
        """Compile planner and low level.

        Args:
            show: called with what is compiled next.

        Raises:
            UnknownNameError: the gait has no such command, or there is no such motion.
            SolverError: the quadratic program is not installed.
        """
        show("planner")
        made: Any = self._planner  # of one motion or several
        self.mpc = made(self.declared, latency=self.latency, **self.options)
        for command in self.commands:
            self.mpc.checked_commands(command.values)
        if self.latency > self.mpc.period:
            raise ModelError(
                f"command line: latency is out of range - got {self.latency:g} s, expected at most the period of the "
                f"plans, {self.mpc.period:g} s; change one"
            )
        show("low level")
        self.low_level(self.mpc.plan(self.problem.initial, 0.0))

    def low_level(self, plan: Plan) -> LowLevel:
        """Return the low level of the settings for plans like this one."""
        low, pair = self.settings.low, self.settings.joint_gains
        gains = None if pair is None else JointPD(*pair)
        if low == "vwbc":
            qp: Any = self.settings.qp or "own"  # checked before
            return Vwbc(plan, leave_out=_HORIZONTAL, qp=qp, gains=gains)
        if low == "riccati":
            return Riccati(plan, leave_out=_HORIZONTAL, gains=gains)
        return FeedforwardPD(plan) if pair is None else FeedforwardPD(plan, kp=pair[0], kd=pair[1])

    @property
    def periods(self) -> int:
        """Number of plans of an episode."""
        return int(np.ceil(self.settings.seconds / self.mpc.period - 1e-9))

    @property
    def title(self) -> str:
        """What runs, in a line."""
        low, qp = self.settings.low, self.settings.qp or "own"
        named = f"{low} ({qp})" if low == "vwbc" else low
        motions = f" of {', '.join(self.mpc.names)}" if isinstance(self.mpc, Motions) else ""
        return f"mpc{motions}, {self.mpc.period * 1e3:g} ms, {self.mpc.iterations} iterations, low level {named}"

    def run(self, seed: int, progress: Callable[[float, float], None] | None = None) -> OnlineEpisode:
        """Return the episode of a seed, with a low level of its own; equal seeds return equal episodes."""
        self.mpc.reset()
        low = self.low_level(self.mpc.plan(self.problem.initial, 0.0))
        return self.episode(self.mpc, low, seed, progress)

    def episode(
        self, planner: Any, low: Any, seed: int, progress: Callable[[float, float], None] | None = None
    ) -> OnlineEpisode:
        """Return the episode of a seed with another planner and low level, such as exported ones."""
        plant = self.plant(seed)
        start = self.variation.start.around(plant.model, self.problem.initial, seed)
        return run_online(
            planner, low, plant, seconds=self.settings.seconds, latency=self.latency, seed=seed, initial=start,
            pushes=self.pushes, commands=self.commands, fall=self.fall, progress=progress,
        )  # fmt: skip


def planner_of(problem: Problem | dict[str, Problem]) -> type[RecedingHorizon] | type[Motions]:
    """Return the class that plans one problem, or several."""
    return RecedingHorizon if isinstance(problem, Problem) else Motions


def _first_of(problems: Mapping[str, Problem], options: Mapping[str, Any]) -> Problem:
    """Return the problem of the first motion; Motions refuses an unknown one."""
    return problems.get(options.get("start", ""), next(iter(problems.values())))


def _checked_options(options: Any, planner: type[Any], file: str) -> dict[str, Any]:
    """Return the file's ``mpc``: arguments of RecedingHorizon, or of Motions, by name."""
    name_of = planner.__name__
    if not isinstance(options, Mapping):
        raise ProblemError(
            f"file '{file}', name 'mpc': is not a dict - got {type(options).__name__}, expected arguments of "
            f"solvers.{name_of} by name; write mpc = dict(period=0.02)"
        )
    known = [name for name in inspect.signature(RecedingHorizon).parameters if name != "problem"]
    if planner is Motions:
        known += [name for name in inspect.signature(Motions).parameters if name not in ("problems", "options")]
    for name in options:
        if name not in known:
            raise UnknownNameError(f"file '{file}', name 'mpc'", f"argument of {name_of}", str(name), known)
    return dict(options)


def _checked_fall(fall: Any, file: str) -> Fall | None:
    """Return the file's ``fall``."""
    if fall is None or isinstance(fall, Fall):
        return fall
    raise ProblemError(
        f"file '{file}', name 'fall': is not the definition of a fall - got {type(fall).__name__}, expected "
        "models.Fall(tilt=..., height=...); fix it, or give it another name"
    )


def _require_joints(problem: Problem, file: str) -> None:
    """Raise unless the first model is that of a robot whose joints can be simulated."""
    model: Any = problem.schedule.segments[0].model
    robot = getattr(model, "robot", None)
    if isinstance(robot, Robot) and {joints.position, joints.velocity} <= set(model.state.slices):
        return
    if isinstance(robot, Robot):
        raise ProblemError(
            f"file '{file}': the first model cannot be simulated - got '{model.name}', expected a model of a robot "
            "with joints, as models.WholeBody; let the schedule begin with one"
        )
    raise ProblemError(
        f"file '{file}': the first model cannot be simulated - got '{model.name}' without a robot, expected a "
        f"models.WholeBody, whose robot MuJoCo simulates; {_OWN_MODEL}"
    )
