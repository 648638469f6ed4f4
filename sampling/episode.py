"""Episodes: a controller and a plant in closed loop, and what came of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import SamplingError
from piaffe.models import Mujoco, base

from .engines import NativeEngine
from .mppi import MPPI

Array = NDArray[np.float64]

Progress = Callable[[int, int], None]
"""Called with steps done and steps in all."""


@dataclass(frozen=True, eq=False)
class Episode:
    """What happened in closed loop, up to a fall.

    Args:
        times: of the states, (T + 1,) [s].
        states: of the plant (T + 1, nx).
        actions: (T, nu).
        cost: running cost at every step (T,).
        reward: of the cost (T,).
        violation: of the rows of constraints (nc, T), divided by each row's scale.
        constraints: the constraint that each row belongs to, (nc,).
        steps: how many steps were asked for.
        fell: whether the robot fell within them.
        distance: covered in the direction of the command, on the ground [m].
        commanded: the distance that the reference covers in the same time [m].
        plan_ms: time of every plan (T,) [ms].
        effective_samples: of every plan (T,).
        failed_rollouts: NaN roll-outs in all.
    """

    times: Array
    states: Array
    actions: Array
    cost: Array
    reward: Array
    violation: Array
    constraints: tuple[str, ...]
    steps: int
    fell: bool
    distance: float
    commanded: float
    plan_ms: Array
    effective_samples: Array
    failed_rollouts: int

    @property
    def success(self) -> bool:
        """Whether it stood to the end and covered at least 0.8 of the commanded distance."""
        return not self.fell and self.distance >= 0.8 * self.commanded

    @property
    def speed_error(self) -> float:
        """How far the mean speed is from the commanded one [m/s]."""
        return abs(self.distance - self.commanded) / float(self.times[-1] - self.times[0])

    @cached_property
    def missed(self) -> Mapping[str, float]:
        """Mean violation of each constraint over the steps, of its worst row in every step."""
        names = np.array(self.constraints)
        return {
            name: float(self.violation[names == name].max(axis=0).mean()) for name in dict.fromkeys(self.constraints)
        }

    def summary(self) -> dict[str, Any]:
        """Return the figures of the episode, as JSON-able values."""
        return {
            "success": self.success,
            "fell": self.fell,
            "steps": len(self.actions),
            "steps_asked": self.steps,
            "mean_reward": float(self.reward.sum() / self.steps),
            "mean_cost": float(self.cost.mean()),
            "missed_percent": {name: 100 * value for name, value in self.missed.items()},
            "distance_m": self.distance,
            "commanded_m": self.commanded,
            "speed_error_m_per_s": self.speed_error,
            "plan_ms_median": float(np.median(self.plan_ms)),
            "plan_ms_p95": float(np.percentile(self.plan_ms, 95)),
            "effective_samples_median": float(np.median(self.effective_samples)),
            "failed_rollouts": self.failed_rollouts,
        }


def run_episode(
    controller: MPPI,
    plant: Any = None,
    *,
    steps: int = 400,
    seed: int = 0,
    initial: ArrayLike | None = None,
    latency: float = 0.0,
    start: float = 0.0,
    progress: Progress | None = None,
) -> Episode:
    """Run a controller against a plant, from the problem's initial state, until it falls or the steps are done.

    Args:
        controller: any of the family; it is reset first.
        plant: a ``models.Mujoco`` with the same control step, ``model.as_plant(timestep=0.002)`` by default.
        steps: control steps.
        seed: of the controller's perturbations.
        initial: state (nx,); the problem's by default.
        latency: time from a state to the first effect of the control planned for it [s]; the control before holds.
        start: time since the motion's start [s].
        progress: called after every step.

    Raises:
        SamplingError: there are no steps, the plant has other joints or another control step, or the latency is
            longer than that.
    """
    if steps < 1:
        raise SamplingError(f"episode: steps are out of range - got {steps!r}, expected at least 1; change them")
    plant = controller.model.as_plant() if plant is None else plant
    lag = _lag(controller, plant, latency)
    k0 = round(start / controller.dt)
    controller.reset(seed)
    engine = NativeEngine(_SingleSteps(plant), threads=0, warm_start=True)
    x = np.array(controller.problem.initial if initial is None else initial, dtype=float)
    states, actions, plan_ms, effective, failed = [x], [], [], [], 0
    before = controller.hold(x)
    fell = False
    for k in range(steps):
        plan = controller.plan(x, (k0 + k) * controller.dt)
        held = np.repeat(plan.action[None], plant.substeps, axis=0)
        held[:lag] = before
        before = plan.action
        rolled = engine.rollout(x, held[None])
        x = rolled.states[0, -1].copy()
        states.append(x)
        actions.append(plan.action)
        plan_ms.append(1e3 * sum(plan.seconds.values()))
        effective.append(plan.effective_samples)
        failed += plan.failed
        if progress is not None:
            progress(k + 1, steps)
        fell = bool(rolled.failed[0]) or bool(plant.fallen(x))
        if fell:
            break
    engine.close()
    return _episode(
        controller, k0, np.array(states), np.array(actions), steps, fell, np.array(plan_ms), np.array(effective), failed
    )


@dataclass(frozen=True)
class _SingleSteps:
    """A plant that takes one control per step of its simulator."""

    plant: Any
    substeps: int = 1

    def compiled(self) -> Any:
        """Return the ``mujoco.MjModel``."""
        return self.plant.compiled()


def _lag(controller: MPPI, plant: Any, latency: float) -> int:
    """Return a latency in steps of the plant's simulator."""
    if not (isinstance(plant, Mujoco) and plant.robot.joint_names == controller.model.robot.joint_names):
        name, robot = getattr(plant, "name", plant), controller.model.robot.name
        raise SamplingError(
            f"episode: plant is unusable - got {name!r}, expected a models.Mujoco with the joints of robot '{robot}'; "
            "make it with model.as_plant()"
        )
    if abs(plant.dt - controller.dt) > 1e-9:
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
    controller: MPPI, k0: int, states: Array, actions: Array, steps: int, fell: bool, plan_ms: Array,
    effective: Array, failed: int,
) -> Episode:  # fmt: skip
    count = len(actions)
    numbers = controller.nodes.running(k0, count)
    cost, violation = controller.score(states[None, :-1], actions[None], numbers)
    where = controller.model.state.slices[base.position]
    asked = [np.asarray(controller.nodes.sample(k)[base.position])[:2] for k in (k0, k0 + count)]
    way = asked[1] - asked[0]
    commanded = float(np.linalg.norm(way))
    ahead = way / commanded if commanded > 0 else np.zeros(2)
    covered = states[-1, where][:2] - states[0, where][:2]
    return Episode(
        times=np.asarray((k0 + np.arange(count + 1)) * controller.dt, dtype=float),
        states=states,
        actions=actions,
        cost=cost[0].copy(),
        reward=controller.reward(cost[0]),
        violation=violation[:, 0].copy(),
        constraints=controller.constraints,
        steps=steps,
        fell=fell,
        distance=float(covered @ ahead),
        commanded=commanded,
        plan_ms=plan_ms,
        effective_samples=effective,
        failed_rollouts=failed,
    )
