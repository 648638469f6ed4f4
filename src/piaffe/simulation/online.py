"""The closed loop of a planner, a low level and a plant, at two rates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, pi
from time import thread_time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError, ShapeError
from piaffe.models import Fall, base, joints
from piaffe.ocp import SAME_TIME

from .command import Command
from .contacts import planned_contacts
from .estimator import Estimator
from .log import Log
from .numbers import finite_number, whole_steps
from .online_episode import OnlineEpisode, PlanLog
from .plan_velocity import planned_velocity
from .planner import LowLevelLike, Planner
from .plant import Plant
from .policy_run import Control
from .push import Push
from .pushes import Pushes
from .two_rates import Rates, TwoRates

Array = NDArray[np.float64]

Touch = Callable[[Array], None]
"""Called before every tick with which feet are on the ground by their force, 1 or 0, (nf,)."""

_LOADED = 0.01  # a foot is on the ground if its normal force exceeds this share of the robot's weight
_FALLEN_TILT, _FALLEN_HEIGHT = 1.2, 0.4  # [rad]; of the height at which the robot stands
_HOLD_ERROR, _HOLD_DAMPING = 0.675, 0.02  # angle error at which the limit is commanded [rad]; damping to stiffness [s]
_VELOCITY = ("vx", "vy", "yaw_rate")


def run_online(
    planner: Planner | None,
    low: LowLevelLike,
    plant: Plant,
    *,
    seconds: float,
    tick: float = 0.002,
    latency: float = 0.0,
    seed: int = 0,
    start: float = 0.0,
    initial: ArrayLike | None = None,
    pushes: Sequence[Push] = (),
    commands: Sequence[Command] = (),
    fall: Fall | None = None,
    hold: Control | None = None,
    estimator: Estimator | None = None,
    touch: Touch | None = None,
    every: int = 1,
    progress: Callable[[float, float], None] | None = None,
) -> OnlineEpisode:
    """Run a planner and a low level against a plant, until it falls or the time is over.

    A plan is made every ``planner.period``. It acts ``latency`` after the state from which it was made; until then the
    plan before acts. The low level acts every ``tick``, and when a plan begins to act; its torques are held in between.
    Until the first plan acts, the joints are held at their first angles.

    Args:
        planner: the planner; it is reset first. Without one, the low level follows the plan that it has.
        low: the low level.
        plant: the robot.
        seconds: duration [s], a multiple of the plant's time step.
        tick: time between ticks [s], a multiple of the plant's time step.
        latency: from a state to the first effect of its plan [s], a multiple of the plant's time step, at most the
            period.
        seed: seed of the sensors' noise.
        start: time since the motion's start [s].
        initial: first state of the plant (nx,); by default ``planner.initial``, else the first state of the low
            level's plan, else the robot stands.
        pushes: on the base.
        commands: to the planner; its ``command`` must exist.
        fall: the definition of a fall, judged at ticks; its height is that of the base above the ground. By default a
            tilt of 1.2 rad, and 0.4 of the height at which the robot stands.
        hold: torques of a state and a time before the first plan acts; by default gains on the joints.
        estimator: estimates the state from the sensors on the robot; by default the measured state is used.
        touch: called before every tick with the feet that are on the ground by their force, for a low level that
            follows measured contacts.
        every: one tick of so many is recorded, for long episodes.
        progress: called after every period with the time that is simulated and ``seconds``.

    Raises:
        ModelError: a number is out of range, or the planner does not take commands.
        ShapeError: state or control has the wrong size.
    """
    step = plant.timestep
    ticks = whole_steps("online", "tick", tick, step, least=1)
    steps = whole_steps("online", "seconds", seconds, step, least=1)
    lag = whole_steps("online", "latency", latency, step) if planner is not None else 0
    period = (
        ticks if planner is None else ticks * whole_steps("online", "planner's period", planner.period, tick, least=1)
    )
    if lag > period:
        raise ModelError(
            f"online: latency is out of range - got {latency:g} s, expected at most the planner's period, "
            f"{period * step:g} s; a planner makes one plan at a time"
        )
    if not (isinstance(every, int) and every >= 1):
        raise ModelError(f"online: every is out of range - got {every!r}, expected a whole number ≥ 1; change it")
    x = np.array(_initial(planner, low, plant) if initial is None else initial, dtype=float)
    at = finite_number("online", "start", start)
    run = _Online(planner, low, plant, x, pushes, commands, seed, at, ticks)
    run.fall = fall or Fall(_FALLEN_TILT, _FALLEN_HEIGHT * plant.robot.base_height())
    run.hold, run.estimator, run.touch = hold or _joint_gains(plant, x), estimator, touch
    run.begin(x, steps // ticks + steps // period + 2, every)
    loop = TwoRates(run.simulation, run, Rates(period, ticks, lag), limit=steps)
    k = 0
    while not loop.over:
        loop.period(at + k * period * step)
        k += 1
        if progress is not None:
            progress(min(k * period, steps) * step, seconds)
    return run.episode(float(seconds), at + loop.steps * step)


class _Online:
    """What happens at the steps of a loop: plans, ticks, pushes, commands, and their record."""

    fall: Fall
    hold: Control
    estimator: Estimator | None
    touch: Touch | None

    def __init__(
        self, planner: Planner | None, low: LowLevelLike, plant: Plant, x: Array, pushes: Sequence[Push],
        commands: Sequence[Command], seed: int, start: float, ticks: int,
    ) -> None:  # fmt: skip
        self.simulation = plant.simulate(x)
        self._planner, self._low, self._plant, self._ticks = planner, low, plant, ticks
        self._sensors = plant.sensors(seed)
        self._pushes = Pushes(pushes, plant.space, start, plant.timestep)
        self._commands = sorted(commands, key=lambda each: each.time)
        if commands and not callable(getattr(planner, "command", None)):
            raise ModelError(
                f"online: the planner takes no commands - got {len(commands)} of them and {planner!r}, expected a "
                "planner with command(**values); leave commands out"
            )
        self._asked = dict.fromkeys(_VELOCITY, 0.0 if commands else np.nan)
        self._where = plant.space.slices
        self.fault = ""

    def begin(self, x: Array, rows: int, every: int) -> None:
        """Prepare the first step."""
        nf, nu = len(self._plant.robot.feet), self._plant.robot.num_joints
        self._weight = float(self.simulation.weight)
        self._log = Log(
            rows,
            {
                "times": (), "states": x.shape, "estimates": x.shape, "controls": (nu,), "torques": (nu,),
                "limited": (nu,), "forces": (nf, 3), "slips": (nf,), "planned": (nf,), "commands": (3,), "ages": (),
                "tick_seconds": (), "qp_iterations": (),
            },
            every,
        )  # fmt: skip
        self._plans: list[tuple[float, float, float, str]] = []
        self._collisions: dict[str, float] = {}
        self._acting, self._made = self._planner is None, np.nan
        self._step, self._control, self._recorded = 0, np.zeros(nu), False
        self._sensed, self._estimate, self._before = -1, x, (x, np.nan)
        self._counts = {name: getattr(self._low, name, 0) for name in ("fallbacks", "damped")}
        self._contacts = planned_contacts(self._low) if self._planner is None else None
        if self._planner is not None:
            self._planner.reset()
        if self.estimator is not None:
            self.estimator.reset(x)

    # ---- the steps of the loop

    @property
    def done(self) -> bool:
        """Whether the episode ends before its time."""
        return bool(self.fault)

    def measure(self, t: float) -> Array:
        """Tell the planner its commands, and return the measured state (nx,)."""
        while self._commands and self._commands[0].time <= t + SAME_TIME:
            values = self._commands.pop(0).values
            self._planner.command(**values)  # type: ignore[union-attr]  # commands need such a planner, see __init__
            self._asked.update({name: value for name, value in values.items() if name in _VELOCITY})
        return self._sense(self.simulation.state, t) if self._planner is not None else self._estimate

    def plan(self, x: Array, t: float) -> None:
        """Make a plan, which the low level follows from now on."""
        if self._planner is None:
            return
        begin = thread_time()
        plan = self._planner.plan(x, t)
        seconds = thread_time() - begin
        self._low.follow(plan)
        self._acting, self._made = True, t
        self._contacts = planned_contacts(self._low, plan)
        status = getattr(plan, "status", "")
        iterations = getattr(plan, "iterations", np.nan)
        self._plans.append((t, seconds, float(iterations), str(getattr(status, "name", status))))

    def control(self, t: float, due: bool) -> Array:
        """Return the torques of a step, (nu,)."""
        self._pushes.apply(self.simulation, self._step)
        if due:
            self._tick(self.simulation.state, t)
        elif not self._acting:
            self._control = self.hold(self.simulation.state, t)
        self._step += 1
        return self._control

    def _tick(self, x: Array, t: float) -> None:
        self._complete()
        self.fault = self._fault_of(x)
        if self.fault:
            return
        if self.touch is not None:
            self.touch((self.simulation.foot_forces()[:, 2] >= self._weight * _LOADED).astype(float))
        measured, seconds = self._sense(x, t), np.nan
        if self._acting:
            begin = thread_time()
            control = self._low.control(measured, t)
            seconds = thread_time() - begin
        else:
            control = self.hold(x, t)
        self._control = np.asarray(control, dtype=float)
        if self._control.shape != (self._plant.robot.num_joints,):
            raise ShapeError(
                f"online: the control has the wrong size - got shape {self._control.shape}, expected "
                f"({self._plant.robot.num_joints},); the low level returns a torque per joint"
            )
        self._recorded = self._log.due
        if self._recorded:
            self._record(x, measured, t, seconds)
        else:
            self._log.skip()
        if not np.all(np.isfinite(self._control)):
            bad = [
                name for name, u in zip(self._plant.robot.joint_names, self._control, strict=True) if not np.isfinite(u)
            ]
            self.fault = f"the control is not finite: {', '.join(bad)}"

    def _fault_of(self, x: Array) -> str:
        """Return why the episode ends in a state; empty if it does not."""
        if self.simulation.failed:
            return "the simulation diverged"
        qx, qy = x[self._where[base.orientation]][1:3]
        if 1.0 - 2.0 * (qx * qx + qy * qy) < cos(min(self.fall.tilt, pi)):
            return f"the base is tilted by more than {self.fall.tilt:g} rad"
        place = x[self._where[base.position]]
        ground = float(np.asarray(self._plant.scene.terrain.height(place[0], place[1])))
        if place[2] - ground < self.fall.height:
            return f"the base is lower than {self.fall.height:.3g} m above the ground"
        return ""

    def _sense(self, x: Array, t: float) -> Array:
        """Return the measured or estimated state (nx,), the same for all who ask in one step."""
        if self._sensed == self._step:
            return self._estimate
        if self.estimator is None:
            self._estimate = self._sensors.state(x)
        else:
            before, then = self._before
            elapsed = 0.0 if np.isnan(then) else t - then
            on = (self.simulation.foot_forces()[:, 2] >= self._weight * _LOADED).astype(float)
            reading = self._sensors.reading(x, before, elapsed, on, self._planned(t))
            self._estimate, self._before = self.estimator.estimate(reading, elapsed), (x, t)
        self._sensed = self._step
        return self._estimate

    # ---- the record

    def _planned(self, t: float) -> Array:
        return np.full(len(self._plant.robot.feet), np.nan) if self._contacts is None else self._contacts(t)

    def _record(self, x: Array, measured: Array, t: float, seconds: float) -> None:
        for name in self.simulation.others_in_contact():
            self._collisions.setdefault(name.removesuffix(" hull"), t)
        velocity = getattr(self._planner, "velocity", None)
        self._log.add(
            times=t, states=x, estimates=measured, controls=self._control, forces=self.simulation.foot_forces(),
            slips=self.simulation.foot_slip() / self.simulation.timestep, planned=self._planned(t),
            commands=velocity(t) if callable(velocity) else [self._asked[name] for name in _VELOCITY],
            ages=t - self._made, tick_seconds=seconds,
            qp_iterations=getattr(getattr(self._low, "last", None), "iterations", np.nan) if self._acting else np.nan,
        )  # fmt: skip

    def _complete(self) -> None:
        """Record the torques that acted in the last step, if its tick is recorded."""
        if self._recorded:
            self._log.complete(torques=self.simulation.torque, limited=self.simulation.limited)
            self._recorded = False

    def episode(self, seconds: float, end: float) -> OnlineEpisode:
        """Return the record.

        Args:
            seconds: the requested duration [s].
            end: time of the last state [s].
        """
        self._complete()
        log, last = self._log, self.simulation.state
        self.fault = self.fault or self._fault_of(last)
        commands = log["commands"]
        if self._planner is None and np.isnan(commands).all():
            commands = planned_velocity(getattr(self._low, "plan", None), log["times"])
        made = self._plans
        times, each, iterations = (np.array([row[i] for row in made], dtype=float) for i in range(3))
        plans = PlanLog(times, each, iterations, tuple(row[3] for row in made if row[3]))
        tables = ("times", "states", "estimates", "controls", "torques", "forces", "slips", "planned", "ages")
        return OnlineEpisode(
            robot=self._plant.robot, space=self._plant.space, seconds=seconds,
            **{name: log[name] for name in (*tables, "tick_seconds", "qp_iterations")},
            commands=commands, limited=log["limited"] > 0.5, torque_limit=self._plant.torque_limit, plans=plans,
            collisions=self._collisions, last=last, end=end, fault=self.fault, least_force=self._weight * _LOADED,
            fallbacks=getattr(self._low, "fallbacks", 0) - self._counts["fallbacks"],
            damped=getattr(self._low, "damped", 0) - self._counts["damped"],
        )  # fmt: skip


def _initial(planner: Any, low: Any, plant: Plant) -> Array:
    """Return the first state of planner or plan, (nx,); a standing robot if there is none of this size."""
    phases = getattr(getattr(low, "plan", None), "phases", None)
    for given in (getattr(planner, "initial", None), phases[0].states[0] if phases else None):
        if given is not None and np.shape(given) == (plant.space.nx,):
            return np.asarray(given, dtype=float)
    x, where = np.zeros(plant.space.nx), plant.space.slices
    x[where[base.position]] = (0.0, 0.0, plant.robot.base_height())
    x[where[base.orientation]] = (1.0, 0.0, 0.0, 0.0)
    x[where[joints.position]] = plant.robot.pose("stand")
    return x


def _joint_gains(plant: Plant, x: Array) -> Control:
    """Return gains that hold the joints of a state: the torque limit at an error of 0.675 rad, and damping."""
    q, v = plant.space.slices[joints.position], plant.space.slices[joints.velocity]
    target, limit = x[q].copy(), plant.torque_limit
    kp = np.where(np.isfinite(limit), limit, plant.simulate(x).weight * plant.robot.base_height()) / _HOLD_ERROR

    def control(state: Array, t: float) -> Array:
        return np.asarray(kp * (target - state[q]) - _HOLD_DAMPING * kp * state[v])

    return control
