"""The closed loop of a planner, a low level and a plant, at two rates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError
from piaffe.models import Fall, base, joints

from .command import Command
from .estimator import Estimator
from .numbers import finite_number, whole_steps
from .online_episode import OnlineEpisode
from .online_run import OnlineRun
from .planner import LowLevelLike, Planner
from .planning import PlanningInThread
from .plant import Plant
from .policy_run import Control
from .push import Push
from .two_rates import Rates, TwoRates
from .wall_clock import WallClock

Array = NDArray[np.float64]

_FALLEN_TILT, _FALLEN_HEIGHT = 1.2, 0.4  # [rad]; of the height at which the robot stands
_HOLD_ERROR, _HOLD_DAMPING = 0.675, 0.02  # angle error at which the limit is commanded [rad]; damping to stiffness [s]


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
    every: int = 1,
    wall_clock: bool | WallClock = False,
    progress: Callable[[float, float], None] | None = None,
) -> OnlineEpisode:
    """Run a planner and a low level against a plant, until it falls or the time is over.

    A plan is made every ``planner.period``. It acts ``latency`` after the state from which it was made; until then the
    plan before acts. The low level acts every ``tick``, and when a plan begins to act; its torques are held in between.
    Until the first plan acts, the joints are held at their first angles.

    With ``solvers.RecedingHorizon`` and a compiled low level of ``piaffe.solvers``, plans and ticks are a
    ``solvers.Loop``, the same C that runs against the real clock: it decides when a plan is made and when it acts,
    which is not before its start. Other planners and low levels are called from Python at the same times.

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
        every: one tick of so many is recorded, for long episodes.
        wall_clock: pace the simulation by the real clock, and plan in a thread of its own. The first plan is made
            before the clock starts, and acts at once. A plan that is not ready after the latency is missed; the one
            before goes on.
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
    if wall_clock and planner is not None and not lag:
        raise ModelError(
            "online: a plan needs time against the real clock - got latency=0, expected at least a step of the "
            f"simulator, {step:g} s; give the planner's latency"
        )
    run = OnlineRun(planner, low, plant, x, pushes, commands, seed, at, tick)
    run.fall = fall or Fall(_FALLEN_TILT, _FALLEN_HEIGHT * plant.robot.base_height())
    run.hold, run.estimator = hold or _joint_gains(plant, x), estimator
    run.begin(x, steps // ticks + steps // period + 2, every)
    loop = TwoRates(run.simulation, run, Rates(period, ticks, lag), limit=steps)
    clock = wall_clock if isinstance(wall_clock, WallClock) else WallClock() if wall_clock else None
    with ExitStack() as stack:
        if clock is not None:
            run.clock = stack.enter_context(clock)
        if planner is not None and _runs_in_loop(planner, low):
            made: Any = planner
            run.run_in(stack.enter_context(made.running(low, thread=clock is not None, latency=latency)))
        elif planner is not None and clock is not None:
            run.planning = PlanningInThread(planner, clock.executor)
        k = 0
        while not loop.over:
            loop.period(at + k * period * step)
            k += 1
            if progress is not None:
                progress(min(k * period, steps) * step, seconds)
    return run.episode(float(seconds), at + loop.steps * step)


def _runs_in_loop(planner: Any, low: Any) -> bool:
    """Return whether a planner has loops, and both are compiled."""
    backends = {getattr(each, "backend", "") for each in (planner, low)}
    return callable(getattr(planner, "running", None)) and backends == {"native"}


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
