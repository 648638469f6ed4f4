"""What ``piaffe mpc`` runs: planner, low level and plant of a file; and its output."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from piaffe.errors import ModelError, ProblemError, SolverError, UnknownNameError
from piaffe.models import Robot, joints
from piaffe.models import payload as mass_on_base
from piaffe.ocp import Problem, is_same_time
from piaffe.simulation import OnlineEpisode, Perturbation, Plant, parse_commands, parse_pushes, run_online
from piaffe.solvers import FeedforwardPD, LowLevel, Plan, RecedingHorizon, Riccati, Vwbc

from .reports import new_table, plain

LOWS = ("vwbc", "riccati", "pd")
_QPS = ("own", "numpy", "daqp", "osqp")
_HORIZONTAL = ("base.position x", "base.position y")  # the path is free; the command is a velocity


class OnlineSetup:
    """Planner, low level and plant of a command line. What is wrong is refused before anything is compiled.

    Args:
        problem: the declaration.
        options: arguments of ``RecedingHorizon`` that the file has.
        file: the file, for errors.
        low: name of the low level. qp: method of its quadratic program.
        seconds: duration of an episode [s].
        latency: from a state to the first effect of its plan [s]; None for that of the options.
        payload: mass on the plant's base [kg].
        friction: of the plant; None for its own.
        pushes, commands: texts.
        plant_file: a MuJoCo model of the robot; None for the robot of the problem.
        perturbation: factor of the perturbations of the first state.

    Raises:
        ProblemError: the file's options are unusable, or the first model has no robot.
        ModelError: a number or text is unusable.
        UnknownNameError: there is no such low level, quadratic program or option.
        SolverError: the low level has no quadratic program.
    """

    mpc: RecedingHorizon

    def __init__(
        self, problem: Problem, options: Any, *, file: str, low: str, qp: str | None, seconds: float,
        latency: float | None, payload: float, friction: float | None, pushes: Sequence[str], commands: Sequence[str],
        plant_file: Path | None, perturbation: float,
    ) -> None:  # fmt: skip
        if low not in LOWS:
            raise UnknownNameError("command line", "low level", low, LOWS)
        if qp is not None and qp not in _QPS:
            raise UnknownNameError("command line", "quadratic program", qp, _QPS)
        if qp is not None and low != "vwbc":
            raise SolverError(
                f"command line: low level '{low}' has no quadratic program - got --qp {qp}, expected --low vwbc; "
                "remove --qp"
            )
        self.problem, self.low_name, self.qp, self.seconds = problem, low, qp or "own", seconds
        self.options = _checked_options(options, file)
        self.latency = float(self.options.pop("latency", 0.0) if latency is None else latency)
        self.options.pop("latency", None)
        self.pushes, self.commands = parse_pushes(pushes), parse_commands(commands)
        self.robot = _robot(problem, file)
        extra: dict[str, Any] = {} if friction is None else {"friction": friction}
        extra |= {"payload": mass_on_base(payload)} if payload else {}
        self.plant = (
            Plant(self.robot, **extra) if plant_file is None else Plant.from_mjcf(plant_file, self.robot, **extra)
        )
        self.perturbation = Perturbation().scaled(perturbation)
        self.settings = {
            "low": low, "qp": self.qp if low == "vwbc" else None, "seconds": seconds, "latency": self.latency,
            "payload": payload, "friction": friction, "push": " ".join(pushes), "command": " ".join(commands),
            "plant": None if plant_file is None else str(plant_file), "perturbation": perturbation,
        }  # fmt: skip
        self._check_times()

    def _check_times(self) -> None:
        step = self.plant.timestep
        for name, value, least in (("latency", self.latency, 0.0), ("seconds", self.seconds, step)):
            if not (least <= value < np.inf and is_same_time(round(value / step) * step, value)):
                raise ModelError(
                    f"command line: {name} is out of range - got {value:g} s, expected a multiple of the plant's time "
                    f"step {step:g} s, at least {least:g} s; change it"
                )

    def build(self, show: Callable[[str], None]) -> None:
        """Compile planner and low level.

        Args:
            show: called with what is compiled next.

        Raises:
            UnknownNameError: the gait has no such command.
        """
        show("planner")
        self.mpc = RecedingHorizon(self.problem, latency=self.latency, **self.options)
        for command in self.commands:
            self.mpc.horizon.checked_commands(command.values)
        if self.latency > self.mpc.period:
            raise ModelError(
                f"command line: latency is out of range - got {self.latency:g} s, expected at most the period of the "
                f"plans, {self.mpc.period:g} s; change one"
            )
        show("low level")
        self._low_level(self.mpc.plan(self.problem.initial, 0.0))

    def _low_level(self, plan: Plan) -> LowLevel:
        if self.low_name == "vwbc":
            return Vwbc(plan, leave_out=_HORIZONTAL, qp=self.qp)  # type: ignore[arg-type]  # checked above
        return Riccati(plan, leave_out=_HORIZONTAL) if self.low_name == "riccati" else FeedforwardPD(plan)

    @property
    def periods(self) -> int:
        """Number of plans of an episode."""
        return int(np.ceil(self.seconds / self.mpc.period - 1e-9))

    @property
    def title(self) -> str:
        """What runs, in a line."""
        qp = f" ({self.qp})" if self.low_name == "vwbc" else ""
        return f"mpc, {self.mpc.period * 1e3:g} ms, {self.mpc.iterations} iterations, low level {self.low_name}{qp}"

    def run(self, seed: int, progress: Callable[[float, float], None] | None = None) -> OnlineEpisode:
        """Return the episode of a seed, with a low level of its own; equal seeds return equal episodes."""
        self.mpc.reset()
        low = self._low_level(self.mpc.plan(self.problem.initial, 0.0))
        start = self.perturbation.around(self.plant.model, self.problem.initial, seed)
        return run_online(
            self.mpc, low, self.plant, seconds=self.seconds, latency=self.latency, seed=seed, initial=start,
            pushes=self.pushes, commands=self.commands, progress=progress,
        )  # fmt: skip


def _checked_options(options: Any, file: str) -> dict[str, Any]:
    """Return the file's ``mpc``: arguments of RecedingHorizon by name."""
    if not isinstance(options, Mapping):
        raise ProblemError(
            f"file '{file}', name 'mpc': is not a dict - got {type(options).__name__}, expected arguments of "
            "solvers.RecedingHorizon by name; write mpc = dict(period=0.02)"
        )
    known = [name for name in inspect.signature(RecedingHorizon).parameters if name != "problem"]
    for name in options:
        if name not in known:
            raise UnknownNameError(f"file '{file}', name 'mpc'", "argument of RecedingHorizon", str(name), known)
    return dict(options)


def _robot(problem: Problem, file: str) -> Robot:
    """Return the robot of the first model, whose state must be that of a whole body."""
    model: Any = problem.schedule.segments[0].model
    robot = getattr(model, "robot", None)
    if isinstance(robot, Robot) and {joints.position, joints.velocity} <= set(model.state.slices):
        return robot
    raise ProblemError(
        f"file '{file}': the first model cannot be simulated - got '{model.name}', expected a model of a robot with "
        "joints, as models.WholeBody; let the schedule begin with one"
    )


# ---- output


def online_values(setup: OnlineSetup, episodes: Mapping[int, OnlineEpisode]) -> dict[str, Any]:
    """Return the values that ``mpc --json`` prints: settings, figures over all seeds, and figures of each seed.

    Args:
        setup: what ran.
        episodes: its episodes by seed.
    """
    rows = [{"seed": seed, **episode.summary()} for seed, episode in episodes.items()]
    means = ("speed_m_per_s", "rms_velocity_error_m_per_s", "plan_ms_median", "iterations_mean", "tick_us_median")
    worst = ("plan_ms_p99", "tick_us_p99", "plan_age_ms_max", "qp_iterations_max", "slip_max_m_per_s")
    return {
        "problem": str(setup.problem.source), "robot": setup.robot.name, "period_s": setup.mpc.period,
        "iterations": setup.mpc.iterations, "settings": setup.settings, "seeds": len(rows),
        "successes": sum(row["success"] for row in rows), "falls": sum(row["fell"] for row in rows),
        **{name: _over(np.mean, rows, name) for name in means},
        **{name: _over(np.max, rows, name) for name in worst},
        "fallbacks": sum(row["fallbacks"] for row in rows), "episodes": rows,
    }  # fmt: skip


def _over(figure: Callable[[Any], Any], rows: Sequence[Mapping[str, Any]], name: str) -> float | None:
    known = [row[name] for row in rows if row.get(name) is not None]
    return float(figure(known)) if known else None


def print_online(console: Console, setup: OnlineSetup, values: Mapping[str, Any]) -> None:
    """Print a line per seed, means and worst cases over seeds, and the number of successes."""
    console.print(
        f"[bold]{setup.title}[/], latency {setup.latency * 1e3:g} ms; {plain(repr(setup.plant))}",
        soft_wrap=True,
    )
    shown = new_table(
        "seed", ">s", ">speed m/s", ">velocity error m/s", ">ms per plan", ">99 %", ">iterations", ">us per tick",
        ">QP iterations", ">fallbacks", "end",
    )  # fmt: skip
    for row in values["episodes"]:
        shown.add_row(
            str(row["seed"]), f"{row['end_s']:.2f}", _cell(row, "speed_m_per_s", 3),
            _cell(row, "rms_velocity_error_m_per_s", 3), _cell(row, "plan_ms_median", 2), _cell(row, "plan_ms_p99", 2),
            _cell(row, "iterations_mean", 1), _cell(row, "tick_us_median", 0), _cell(row, "qp_iterations_mean", 2),
            str(row["fallbacks"]), _end(row),
        )  # fmt: skip
    console.print(shown)
    for row in values["episodes"]:
        if row["fell"]:
            console.print(f"[red]seed {row['seed']}: {plain(row['fault'])}[/]", soft_wrap=True)
    good = values["successes"] == values["seeds"]
    console.print(
        f"[bold {'green' if good else 'red'}]success in {values['successes']} of {values['seeds']}[/]"
        f" ({setup.seconds:g} s without a fall, and upright at the end)"
    )


def _cell(row: Mapping[str, Any], name: str, digits: int) -> str:
    value = row.get(name)
    return "-" if value is None else f"{value:.{digits}f}"


def _end(row: Mapping[str, Any]) -> str:
    if row["fell"]:
        return "[red]fell[/]"
    return "[green]upright[/]" if row["upright"] else "[red]not upright[/]"
