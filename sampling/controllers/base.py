"""The base class of every sampler: receding-horizon control with roll-outs, which calls three methods of a subclass."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from os import PathLike
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import SamplingError
from piaffe.ocp import Nodes, Problem

from ..engines import engine_for
from ..evaluators import evaluator
from ..options import Options
from ..reward import Reward
from . import horizon
from .closed_loop import ClosedLoop
from .contract import require_methods
from .device_stage import DeviceStage
from .host_stage import HostStage, lap
from .noise import Noise, deviations
from .plan import Plan, report
from .spline import Spline
from .stage import Memory, Rolled, Stage, TerminalValue
from .terminal import terminal_value

Array = NDArray[np.float64]


class Sampler(ClosedLoop):
    """A sampling controller. A subclass defines the samples, the returns of roll-outs and the update of the plan.

    The problem's schedule is ``model.over(H dt, dt)``. Steps 0 … H are simulated. Control 0 is applied while the plan
    is computed, so it is not perturbed; the other H controls are free. As in [DIAL-MPC], a plan consists of the nodes
    of a spline of the controls; each control's range is scaled to [-1, 1]. A plan is computed in stages. Each stage has
    four steps:

    1. :meth:`sample` returns plans to try. They are clipped, and the current plan is added as the last sample.
    2. The samples are rolled out, and their costs and violations are evaluated.
    3. :meth:`returns` gives each roll-out a number. Failed roll-outs get the lowest one.
    4. :meth:`update` returns the new plan.

    The three methods get ``xp``, which is ``numpy`` or, with ``engine="mjx"``, ``jax.numpy``; then they are traced and
    compiled together with the whole stage. So they must be pure functions: they do not change arrays in place, and data
    for later stages are in ``memory``, which is an argument and a result.

    Args:
        problem: the problem; its schedule is one MuJoCo model.
        options: see :class:`Options`; the ``defaults`` of the class by default.
        reward: the reward as a function of the cost.
        value: the return after the last state of a roll-out: a function, a value or the path of its file. Only for
            samplers with ``uses_value``.
        allow: entries that may differ between this controller and the one that the value was learnt for, as
            ``("terrain",)``; see :meth:`piaffe.sampling.value.Value.check`.
        **changed: single options, as ``samples=512``.

    Attributes:
        title: its name in tables and figures; the name of the class by default.
        defaults: its default options.
        uses_value: whether its returns use ``rolled.value``.

    Raises:
        SamplingError: a method is missing, an option is out of range, the model has no range of controls, or the value
            was learnt for something else.
        ProblemError: the problem cannot be sampled.
    """

    title: ClassVar[str] = "Sampler"
    defaults: ClassVar[Options] = Options(stage_factor=1.0, node_factor=1.0, first_stages=1)
    uses_value: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "title" not in vars(cls):
            cls.title = cls.__name__

    def __init__(
        self,
        problem: Problem,
        options: Options | None = None,
        *,
        reward: Reward | None = None,
        value: TerminalValue | str | PathLike[str] | None = None,
        allow: Collection[str] = (),
        **changed: Any,
    ) -> None:
        require_methods(type(self), Sampler)
        self.options = replace(options or self.defaults, **changed)
        self.problem, self.reward = problem, Reward() if reward is None else reward
        if not isinstance(self.reward, Reward):
            raise SamplingError(
                f"controller: reward is unusable - got {reward!r}, expected a sampling.Reward; pass Reward(scale=...)"
            )
        if value is not None and not self.uses_value:
            raise SamplingError(
                f"controller '{type(self).__name__}': uses no value - got {value!r}, expected None; leave it out, or "
                "set uses_value = True in the class and use rolled.value in returns"
            )
        self.nodes = Nodes(problem)
        self.model = horizon.simulated(problem)
        self.dt = self.nodes.dt
        self.steps = horizon.steps_of(problem, self.dt)
        self.spline = Spline(self.options.knots, self.steps)
        self.engine = engine_for(self.model, self.options.engine, threads=self.options.threads)
        self._on_device = self.options.engine == "mjx"
        self.evaluator = evaluator(
            self.nodes.mode, "jax" if self._on_device else "native", threads=self.options.threads
        )
        self.constraints = self.evaluator.constraints(self.nodes.terms)
        self.value = terminal_value(value, self, allow)
        self._centre, self._half = horizon.centre_and_half_range(self.model)
        self._drawing = ThreadPoolExecutor(1)
        self.reset()

    # ---- methods of a subclass

    def initial_memory(self) -> Memory:
        """Return the initial memory: arrays by name, whose names and shapes do not change; empty by default."""
        return {}

    def sample(self, xp: Any, plan: Any, noise: Any, stage: Stage, memory: Memory) -> Any:
        """Return the plans to try, (N, knots + 1, nu), scaled to [-1, 1].

        Numbers beyond ±1 are clipped, and node 0 is replaced by node 0 of the plan.

        Args:
            xp: ``numpy`` or ``jax.numpy``.
            plan: the current plan, (knots + 1, nu).
            noise: standard normal numbers, (N, knots + 1, nu), zero at node 0.
            stage: index of the stage, and the deviations of the options' schedule.
            memory: memory of the sampler.
        """
        raise NotImplementedError

    def returns(self, xp: Any, rolled: Rolled, memory: Memory) -> tuple[Any, Memory]:
        """Return the return of every roll-out, (n,), to be maximised, and the memory.

        Args:
            xp: ``numpy`` or ``jax.numpy``.
            rolled: the roll-outs; n = N + 1, the last one is that of the current plan.
            memory: memory of the sampler.
        """
        raise NotImplementedError

    def update(self, xp: Any, samples: Any, returns: Any, memory: Memory) -> tuple[Any, Any, Memory]:
        """Return the new plan (knots + 1, nu), the weight of every sample (n,), and the memory.

        A weight is the share of a sample in the new plan; the sum of the weights is one. They are only for reports.

        Args:
            xp: ``numpy`` or ``jax.numpy``.
            samples: plans that were rolled out, (n, knots + 1, nu); the last one is the current plan.
            returns: returns of the roll-outs, (n,), finite; failed roll-outs have the lowest one.
            memory: memory of the sampler.
        """
        raise NotImplementedError

    # ---- for subclasses

    def mean_reward(self, rolled: Rolled) -> Any:
        """Return the mean reward of every roll-out, (n,); terms ``at="end"`` count as one more step."""
        rewards = self.reward(rolled.cost)
        if rolled.last is None:
            return rewards.mean(axis=1)
        return (rewards.sum(axis=1) + self.reward(rolled.last)) / (rewards.shape[1] + 1)

    # ---- use

    @property
    def memory(self) -> Memory:
        """The memory of the sampler after the last plan."""
        return self.initial_memory() if self._memory is None else self._memory

    def reset(self, seed: int | None = None) -> None:
        """Delete the last plan and the memory, and restart the random numbers of the perturbations."""
        shape = (self.options.samples, self.options.knots + 1, len(self._centre))
        self._noise = Noise(self.options.seed if seed is None else seed, shape, self._drawing)
        self._plan: Array | None = None  # nodes (knots + 1, nu), scaled to [-1, 1]
        self._memory: Memory | None = None
        self._time = 0.0

    def plan(self, x: ArrayLike, t: float) -> Plan:
        """Return a plan from a state.

        Args:
            x: state (nx,), finite.
            t: time since the motion's start [s]; a multiple of dt unless ``shift="elapsed"``.

        Raises:
            ShapeError: the state has the wrong size.
            SamplingError: the state or the time is not finite, the time is negative or not a multiple of dt, or a
                method of the sampler returns a wrong shape or NaN.
        """
        start = horizon.checked_state(x, self.model)
        if not 0.0 <= t < float("inf"):
            raise SamplingError(
                f"plan: time is out of range - got {t!r}, expected seconds since the motion's start; correct it"
            )
        k = round(t / self.dt)
        first = self._plan is None
        plan = self._first_guess(start) if self._plan is None else self._shifted(self._plan, t)
        numbers = self.nodes.running(k, self.steps + 1)
        memory = self.memory
        seconds: dict[str, float] = defaultdict(float)
        stages = self.options.first_stages if first else self.options.stages
        for i in range(stages):
            began = time.perf_counter()
            stage = Stage(i, stages, deviations(self.options, i, stages)[:, None])
            noise = self._noise()
            lap(seconds, "sample", began)
            staged = self._stage(start, plan, noise, stage, memory, k, numbers, seconds)
            plan, memory = staged.plan, staged.memory
        self._plan, self._memory, self._time = plan, memory, t
        return report(t, staged, self._controls(staged.plan[None])[0], self.constraints, seconds)

    @cached_property
    def _stage(self) -> HostStage | DeviceStage:
        return DeviceStage(self) if self._on_device else HostStage(self)

    # ---- from plan to plan

    def _first_guess(self, start: Array) -> Array:
        """Return the plan that holds the joints at their positions, or has no torque."""
        held = self.hold(start)
        return np.tile(np.clip((held - self._centre) / self._half, -1.0, 1.0), (self.options.knots + 1, 1))

    def _shifted(self, plan: Array, t: float) -> Array:
        """Return the last plan, shifted to start at time t [s]."""
        if self.options.shift == "elapsed":
            return horizon.moved(self.spline, plan, (t - self._time) / self.dt)
        return horizon.moved_by_steps(self.spline, plan, t, self._time, self.dt)

    def _controls(self, plans: Array) -> Array:
        """Return the controls of plans in the model's units, (n, H + 1, nu), within their range."""
        return self.spline.controls(plans, self._centre, self._half)
