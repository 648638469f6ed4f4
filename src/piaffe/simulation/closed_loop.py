"""The closed loop of a controller and a plant, with latency and with the ticks of a low-level controller."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import SamplingError
from piaffe.models import Fall, Mujoco, base
from piaffe.ocp import is_same_time

from .controller import Controller, Plan, TickingController
from .episode import Episode
from .simulation import Simulation
from .two_rates import Rates, TwoRates

Array = NDArray[np.float64]

Progress = Callable[[int, int], None]
"""Called with the number of finished steps and the number of all steps."""


def run_episode(
    controller: Controller,
    plant: Any = None,
    *,
    steps: int = 400,
    seed: int = 0,
    initial: ArrayLike | None = None,
    latency: float = 0.0,
    start: float = 0.0,
    fall: Fall | None = None,
    progress: Progress | None = None,
) -> Episode:
    """Run a controller against a plant, from the problem's initial state, until it falls or the steps are done.

    Args:
        controller: the controller; it is reset first. A :class:`TickingController` also acts between plans.
        plant: a ``models.Mujoco`` with the same control step, ``model.as_plant(timestep=0.002)`` by default.
        steps: number of control steps.
        seed: seed of the controller's random numbers.
        initial: state (nx,); the problem's by default.
        latency: time from a state to the first effect of its plan [s]; the previous plan acts until then.
        start: time since the motion's start [s].
        fall: the condition of a fall, which ends the episode; ``models.Fall()`` by default.
        progress: called after every step.

    Raises:
        SamplingError: ``steps`` is not positive, the plant has other joints or another control step, or the latency is
            longer than a control step.
    """
    if steps < 1:
        raise SamplingError(f"episode: steps are out of range - got {steps!r}, expected at least 1; change them")
    plant = controller.model.as_plant() if plant is None else plant
    lag = _lag(controller, plant, latency)
    loop = _Loop(controller, plant, Rates(plant.substeps, _ticks(controller, plant), lag))
    first = round(start / controller.dt)
    controller.reset(seed)
    x = np.array(controller.initial if initial is None else initial, dtype=float)
    loop.begin(x)
    states, actions, plan_ms, figures = [x], [], [], []
    fell = False
    for k in range(steps):
        plan = loop.step((first + k) * controller.dt)
        states.append(loop.plant.state)
        actions.append(plan.action)
        plan_ms.append(1e3 * sum(plan.seconds.values()))
        figures.append(plan.figures)
        if progress is not None:
            progress(k + 1, steps)
        fell = loop.plant.failed or bool(plant.fallen(states[-1], fall))
        if fell:
            break
    return _episode(controller, first, np.array(states), np.array(actions), steps, fell, np.array(plan_ms), figures)


class _Loop:
    """A controller and a plant, one control step after another.

    Args:
        controller: the controller; it plans from the state at the start of a control step.
        model: model of the plant.
        rates: of plans and ticks.
    """

    done = False

    def __init__(self, controller: Controller, model: Mujoco, rates: Rates) -> None:
        self._controller, self._model, self._rates = controller, model, rates

    def begin(self, x: Array) -> None:
        """Set the first state of the plant, (nx,)."""
        self.plant = Simulation(self._model, x)
        self._two_rates = TwoRates(self.plant, self, self._rates)
        self._control = self._controller.hold(x)
        self._planned: Plan | None = None

    def step(self, t: float) -> Plan:
        """Simulate the control step that starts at time t [s], and return its plan."""
        self._two_rates.period(t)
        assert self._planned is not None  # a period makes a plan
        return self._planned

    def measure(self, t: float) -> Array:
        """Return the state of the plant (nx,)."""
        measured = self.plant.state
        self.plant.settle()
        return measured

    def plan(self, x: Array, t: float) -> None:
        """Make a plan."""
        self._planned = self._controller.plan(x, t)
        self._control = np.asarray(self._planned.action, dtype=float)

    def control(self, t: float, due: bool) -> Array:
        """Return the control, (nu,): that of the plan, or of the last tick."""
        if due and self._planned is not None and self._rates.tick:
            ticking = self._controller
            assert isinstance(ticking, TickingController)  # it has ticks
            self._control = np.asarray(ticking.tick(self.plant.state, t), dtype=float)
        return self._control


def _ticks(controller: Controller, plant: Mujoco) -> int:
    """Return the number of simulator steps per tick of a controller; 0 if it has no ticks."""
    if not isinstance(controller, TickingController):
        return 0
    ticks = round(controller.tick_dt / plant.timestep)
    if ticks < 1 or not is_same_time(ticks * plant.timestep, controller.tick_dt) or plant.substeps % ticks:
        raise SamplingError(
            f"episode: time between ticks is out of range - got {controller.tick_dt:g} s, expected a multiple of the "
            f"plant's time step {plant.timestep:g} s that divides {controller.dt:g} s; change one of them"
        )
    return ticks


def _lag(controller: Controller, plant: Any, latency: float) -> int:
    """Return a latency as a number of simulator steps; raise if the plant does not fit the controller."""
    if not (isinstance(plant, Mujoco) and plant.robot.joint_names == controller.model.robot.joint_names):
        name, robot = getattr(plant, "name", plant), controller.model.robot.name
        raise SamplingError(
            f"episode: plant is unusable - got {name!r}, expected a models.Mujoco with the joints of robot '{robot}'; "
            "make it with model.as_plant()"
        )
    if not is_same_time(plant.dt, controller.dt):
        raise SamplingError(
            f"episode: plant '{plant.name}' has another control step - got {plant.dt:g} s, expected {controller.dt:g} "
            "s; make it with model.as_plant()"
        )
    lag = round(latency / float(plant.timestep))
    if not 0 <= lag <= int(plant.substeps):
        raise SamplingError(
            f"episode: latency is out of range - got {latency:g} s, expected 0 to {controller.dt:g} s, a control step; "
            "change it"
        )
    return lag


def _episode(
    controller: Controller, first: int, states: Array, actions: Array, steps: int, fell: bool, plan_ms: Array,
    figures: Sequence[Mapping[str, float]],
) -> Episode:  # fmt: skip
    count, dt = len(actions), controller.dt
    judged = controller.judge(states[:-1], actions, first * dt)
    where = controller.model.state.slices[base.position]
    motion = controller.place((first + count) * dt) - controller.place(first * dt)
    commanded = float(np.linalg.norm(motion))
    direction = motion / commanded if commanded > 0 else np.zeros(2)
    covered = states[-1, where][:2] - states[0, where][:2]
    return Episode(
        times=np.asarray((first + np.arange(count + 1)) * dt, dtype=float),
        states=states,
        actions=actions,
        cost=judged.cost,
        reward=judged.reward,
        violation=judged.violation,
        constraints=judged.constraints,
        steps=steps,
        fell=fell,
        distance=float(covered @ direction),
        commanded=commanded,
        plan_ms=plan_ms,
        effective_samples=np.array([row.get("effective_samples", nan) for row in figures]),
        failed_rollouts=int(sum(row.get("failed", 0) for row in figures)),
    )
