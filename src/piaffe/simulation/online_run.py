"""What happens at the steps of an online loop: plans, ticks, pushes, commands, and their record."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi
from time import thread_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError, ShapeError
from piaffe.models import Fall, base
from piaffe.ocp import SAME_TIME

from .command import Command
from .contacts import planned_contacts
from .estimator import Estimator
from .log import Log
from .online_episode import OnlineEpisode, PlanLog
from .plan_velocity import planned_velocity
from .planner import LoopLike, LowLevelLike, Planner
from .planning import MadePlan, Planning, PlanningAtOnce, PlanningInLoop, PlanningInThread
from .plant import Plant
from .policy_run import Control
from .push import Push
from .pushes import Pushes
from .wall_clock import Deadlines, WallClock

Array = NDArray[np.float64]

_LOADED = 0.01  # a foot is on the ground if its normal force exceeds this share of the robot's weight
_COUNTED = ("fallbacks", "relaxed", "damped")  # of a low level
_VELOCITY = ("speed", "lateral_speed", "yaw_rate")


class OnlineRun:
    """What happens at the steps of a loop: plans, ticks, pushes, commands, and their record."""

    fall: Fall
    hold: Control
    estimator: Estimator | None
    planning: Planning | None
    clock: WallClock | None = None

    def __init__(
        self, planner: Planner | None, low: LowLevelLike, plant: Plant, x: Array, pushes: Sequence[Push],
        commands: Sequence[Command], seed: int, start: float, tick: float,
    ) -> None:  # fmt: skip
        self.simulation = plant.simulate(x)
        self._planner, self._low, self._plant, self._tick_s = planner, low, plant, tick
        self.planning = None if planner is None else PlanningAtOnce(planner)
        self._loop: LoopLike | None = None
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
        self._plans: list[tuple[float, float, float, str, str, str, float]] = []
        self._collisions: dict[str, float] = {}
        self._acting, self._made = self._planner is None, np.nan
        self._waits: MadePlan | None = None
        self._step, self._control, self._recorded = 0, np.zeros(nu), False
        self._sensed, self._estimate, self._before = -1, x, (x, np.nan)
        self._counts = {name: getattr(self._low, name, 0) for name in _COUNTED}
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
        """Ask for a plan of the measured state, and return this state (nx,)."""
        if self.planning is None:
            return self._estimate
        x = self._sense(self.simulation.state, t)
        due = [each for each in self._commands if each.time <= t + SAME_TIME]
        if self.planning.ask(x, t, due):
            self._commands = self._commands[len(due) :]
            for command in due:
                self._asked.update({n: float(value) for n, value in command.values.items() if n in _VELOCITY})
        if self._loop is not None and self.clock is not None:
            self._note(self.planning.take(), t)  # the first one, which was made before the clock starts
        return x

    def plan(self, x: Array, t: float) -> None:
        """Take the plan that was asked for, if it is ready; a loop does so itself, from the first one on."""
        made = None if self.planning is None or (self._loop is not None and self._acting) else self.planning.take()
        self._waits = made or self._waits
        self._follow(t)

    def _follow(self, t: float) -> None:
        """Follow the plan that waits, from its start on."""
        made = self._waits
        if made is None or float(getattr(made.plan, "start", t)) > t + SAME_TIME:
            return
        self._waits = None
        if self._loop is None:
            self._low.follow(made.plan)
        self._note(made, t)

    def _note(self, made: MadePlan | None, t: float) -> None:
        """Note that a plan acts from time t on [s]."""
        if made is None:
            return
        self._acting, self._made = True, made.time
        self._contacts = planned_contacts(self._low, None if self._loop is not None else made.plan)
        status, iterations = getattr(made.plan, "status", ""), getattr(made.plan, "iterations", np.nan)
        motion, request = (str(getattr(made.plan, name, "")) for name in ("motion", "request"))
        name = str(getattr(status, "name", status))
        self._plans.append((made.time, made.seconds, float(iterations), name, motion, request, t))

    def run_in(self, loop: LoopLike) -> None:
        """Let a loop, which runs, make plans and ticks."""
        assert self._planner is not None  # it has made the loop
        self._loop, self.planning = loop, PlanningInLoop(self._planner, loop)

    def control(self, t: float, due: bool) -> Array:
        """Return the torques of a step, (nu,)."""
        if self.clock is not None:
            self.clock.reach(t)
        self._pushes.apply(self.simulation, self._step)
        if due:
            self._tick(self.simulation.state, t)
            if self.clock is not None:
                self.clock.ticked(t, self._tick_s)
        elif not self._acting:
            self._control = self.hold(self.simulation.state, t)
        self._step += 1
        return self._control

    def _tick(self, x: Array, t: float) -> None:
        self._complete()
        self._follow(t)
        self.fault = self._fault_of(x)
        if self.fault:
            return
        measured, seconds = self._sense(x, t), np.nan
        if self._acting:
            flags = (self._touching(),) if getattr(self._low, "measures_contacts", False) else ()
            act: Any = (self._loop or self._low).control  # with a third argument if contacts are measured
            begin = thread_time()
            control = act(measured, t, *flags)
            seconds = thread_time() - begin
            if self._loop is not None and self.planning is not None:
                seconds -= self._loop.planning_seconds
                self._note(self.planning.take(), t)
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
            reading = self._sensors.reading(x, before, elapsed, self._touching(), self._planned(t))
            self._estimate, self._before = self.estimator.estimate(reading, elapsed), (x, t)
        self._sensed = self._step
        return self._estimate

    def _touching(self) -> Array:
        """Return which feet are on the ground by their force, 1 or 0, (nf,)."""
        return np.asarray(self.simulation.foot_forces()[:, 2] >= self._weight * _LOADED, dtype=float)

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
        plans = PlanLog(
            times, each, iterations, tuple(row[3] for row in made if row[3]),
            np.array([row[6] for row in made], dtype=float), tuple(row[4] for row in made if row[4]),
            tuple(row[5] for row in made if row[4]),
        )  # fmt: skip
        tables = ("times", "states", "estimates", "controls", "torques", "forces", "slips", "planned", "ages")
        counts = {name: getattr(self._low, name, 0) - before for name, before in self._counts.items()}
        return OnlineEpisode(
            robot=self._plant.robot, space=self._plant.space, seconds=seconds,
            **{name: log[name] for name in (*tables, "tick_seconds", "qp_iterations")},
            commands=commands, limited=log["limited"] > 0.5, torque_limit=self._plant.torque_limit, plans=plans,
            collisions=self._collisions, last=last, end=end, fault=self.fault, least_force=self._weight * _LOADED,
            fallbacks=counts["fallbacks"], relaxed=counts["relaxed"], damped=counts["damped"],
            deadlines=self._deadlines(),
        )  # fmt: skip

    def _deadlines(self) -> Deadlines | None:
        if self.clock is None:
            return None
        asked = missed = 0
        if isinstance(self.planning, PlanningInThread | PlanningInLoop):
            asked, missed = self.planning.asked - 1, self.planning.missed
        return Deadlines(
            max(asked, 0), missed, self.clock.ticks, self.clock.missed, self.clock.latest, self.clock.real_time
        )
