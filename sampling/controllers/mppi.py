"""Model predictive path integral control: perturb a plan, roll out, and average by weight."""

from __future__ import annotations

import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import SamplingError, ShapeError
from piaffe.models import Mujoco, base, joints
from piaffe.ocp import NodeNumbers, Nodes, Problem, whole_steps
from piaffe.simulation import Judgement

from ..engines import engine_for
from ..evaluators import evaluator
from ..options import Options
from ..reward import Reward
from .noise import Noise, deviations
from .plan import Plan
from .spline import Spline

if TYPE_CHECKING:
    from .device_stage import DeviceStage

Array = NDArray[np.float64]

_SPREAD = 1e-6  # least standard deviation of returns; equal returns weigh the same


class MPPI:
    """MPPI in a receding horizon, on roll-outs of a MuJoCo model.

    The problem's schedule is ``model.over(H dt, dt)``. Steps 0 … H are simulated: control 0 is the one that is being
    applied while the plan is made, so it is not perturbed, and H are free. Controls are nodes of a spline in halves of
    their range about its centre [DIAL-MPC]. One stage of a plan:

    1. perturb the nodes but the first, clip, roll out; the unperturbed plan is one more sample;
    2. R_n = the return of roll-out n, here the mean reward;
    3. plan ← Σ w_n plan_n with w = softmax((R − R_best) / (λ std R)).

    Args:
        problem: the declaration; its schedule is one MuJoCo model.
        options: see :class:`Options`; the class's ``defaults`` unless given.
        reward: how cost becomes reward.
        **changed: single options, as ``samples=512``.

    Raises:
        SamplingError: an option is out of range, or the model has no range of controls.
        ProblemError: the problem is not one that can be sampled.
    """

    defaults: ClassVar[Options] = Options(stage_factor=1.0, node_factor=1.0, first_stages=1)

    def __init__(
        self, problem: Problem, options: Options | None = None, *, reward: Reward | None = None, **changed: Any
    ) -> None:
        self.options = replace(options or self.defaults, **changed)
        self.problem, self.reward = problem, Reward() if reward is None else reward
        if not isinstance(self.reward, Reward):
            raise SamplingError(
                f"controller: reward is unusable - got {reward!r}, expected a sampling.Reward; pass Reward(scale=...)"
            )
        self.nodes = Nodes(problem)
        self.model = _simulated(problem)
        self.dt = self.nodes.dt
        self.steps = _horizon(problem, self.dt)
        self.spline = Spline(self.options.knots, self.steps)
        self.engine = engine_for(self.model, self.options.engine, threads=self.options.threads)
        on_device = self.options.engine == "mjx"
        self.evaluator = evaluator(self.nodes.mode, "jax" if on_device else "native", threads=self.options.threads)
        self.constraints = self.evaluator.constraints(self.nodes.terms)
        self._centre = 0.5 * (self.model.action.upper + self.model.action.lower)
        self._half = 0.5 * (self.model.action.upper - self.model.action.lower)
        self._ends = bool(self.nodes.mode.rows["terminal_residual"])
        self._drawing = ThreadPoolExecutor(1)
        self.reset()

    # ---- use

    def reset(self, seed: int | None = None) -> None:
        """Forget the last plan, and begin the perturbations anew."""
        shape = (self.options.samples, self.options.knots, len(self._centre))
        self._noise = Noise(self.options.seed if seed is None else seed, shape, self._drawing)
        self._plan: Array | None = None  # nodes (n + 1, nu) in halves of the range
        self._time = 0.0

    def plan(self, x: ArrayLike, t: float) -> Plan:
        """Return a plan from a state.

        Args:
            x: state (nx,), finite.
            t: time since the motion's start [s]; in multiples of dt unless ``shift="elapsed"``.

        Raises:
            ShapeError: the state has the wrong size.
            SamplingError: the state or the time is not finite, or the time negative or no multiple of dt.
        """
        start = self._checked(x)
        if not 0.0 <= t < float("inf"):
            raise SamplingError(
                f"plan: time is out of range - got {t!r}, expected seconds since the motion's start; pass those"
            )
        k = round(t / self.dt)
        first = self._plan is None
        nodes = self._first_guess(start) if self._plan is None else self._shifted(self._plan, t)
        numbers = self.nodes.running(k, self.steps + 1)
        seconds: dict[str, float] = defaultdict(float)
        stages = self.options.first_stages if first else self.options.stages
        for stage in range(stages):
            sigma = deviations(self.options, stage, stages)
            nodes, rolled = self._stage(start, nodes, sigma, k, numbers, seconds)
        self._plan, self._time = nodes, t
        return self._report(t, nodes, rolled, seconds)

    def hold(self, x: Array) -> Array:
        """Return the control that holds the joints where they are, (nu,); no torque where controls are torques."""
        if self.model.action.quantity == joints.target:
            return np.asarray(x[self.model.state.slices[joints.position]])
        return np.zeros_like(self._centre)

    # ---- in closed loop

    @property
    def initial(self) -> Array:
        """Initial state of the problem (nx,)."""
        return self.problem.initial

    def judge(self, states: Array, actions: Array, t: float) -> Judgement:
        """Return cost, reward and violations of what happened.

        Args:
            states: (T, nx), ``dt`` apart.
            actions: (T, nu).
            t: time of the first [s].
        """
        numbers = self.nodes.running(round(t / self.dt), len(actions))
        cost, violation = self.score(states[None], actions[None], numbers)
        return Judgement(cost[0].copy(), self.reward(cost[0]), violation[:, 0].copy(), self.constraints)

    def place(self, t: float) -> Array:
        """Return where the reference wants the base at a time [s], x and y, (2,) [m]."""
        return np.asarray(self.nodes.sample(round(t / self.dt))[base.position], dtype=float)[:2]

    # ---- what relatives change

    def returns(self, rolled: Rolled) -> Array:
        """Return the return of every roll-out, (n,): here the mean reward."""
        rewards = self.reward(rolled.cost)
        return np.asarray(rewards.mean(axis=1) if rolled.last is None else (
            (rewards.sum(axis=1) + self.reward(rolled.last)) / (rewards.shape[1] + 1)
        ))  # fmt: skip

    # ---- costs

    def score(self, states: Array, controls: Array, numbers: NodeNumbers) -> tuple[Array, Array]:
        """Return running costs (n, S) and violations (nc, n, S); the next call of this size overwrites them.

        Args:
            states: (n, S, nx).
            controls: (n, S, nu).
            numbers: of the S nodes.
        """
        return self.evaluator.stage(states, controls, numbers.p, numbers.weight, numbers.g_mask, numbers.h_mask)

    def _last(self, states: Array, k: int) -> Array:
        """Return the cost of terms ``at="end"``, (n,)."""
        end = self.nodes.end(k)
        cost: Array = self.evaluator.terminal(states, end.p[0], end.weight[0], end.g_mask[0], end.h_mask[0])[0]
        return cost

    # ---- one stage

    def _stage(
        self, start: Array, nodes: Array, sigma: Array, k: int, numbers: NodeNumbers, seconds: dict[str, float]
    ) -> tuple[Array, Rolled]:
        """Return the plan after one stage, and what it was made from."""
        began = time.perf_counter()
        samples = self._perturbed(nodes, sigma)
        if self.options.engine == "mjx":
            return self._stage_on_device(start, samples, k, numbers, seconds, _lap(seconds, "sample", began))
        controls = self._controls(samples)
        began = _lap(seconds, "sample", began)
        rollouts = self.engine.rollout(start, controls)
        began = _lap(seconds, "roll_out", began)
        states = rollouts.states
        cost, violation = self.score(states[:, :-1], controls, numbers)
        last = self._last(states[:, -1], k + self.steps + 1) if self._ends else None
        began = _lap(seconds, "evaluate", began)
        rolled = Rolled(k, states, cost, last, violation, rollouts.failed)
        rolled.returns = self._valid(self.returns(rolled), rollouts.failed)
        began = _lap(seconds, "value", began)
        rolled.weights = softmax(rolled.returns, self.options.temperature)
        mean = np.einsum("n,ni->i", rolled.weights, samples.reshape(len(samples), -1)).reshape(nodes.shape)
        _lap(seconds, "weigh", began)
        return mean, rolled

    def _stage_on_device(
        self, start: Array, samples: Array, k: int, numbers: NodeNumbers, seconds: dict[str, float], began: float
    ) -> tuple[Array, Rolled]:
        """Return the same, from one function on the device; its parts cannot be timed, so all of it is ``roll_out``."""
        staged = self._fused(start, samples, k, numbers, self._moving_maxima())
        self._set_maxima(np.array(staged.maxima))
        fields = (staged.states, staged.cost, staged.violation, staged.failed, staged.returns, staged.weights)
        states, cost, violation, failed, returns, weights = (np.array(each) for each in fields)
        _lap(seconds, "roll_out", began)
        return np.array(staged.nodes), Rolled(k, states, cost, None, violation, failed, returns, weights)

    @cached_property
    def _fused(self) -> DeviceStage:
        from .device_stage import DeviceStage  # it knows values, whose learning imports this module

        return DeviceStage(self, spread=_SPREAD)

    def _moving_maxima(self) -> Array | None:
        """Return the moving maxima of the violations, (nc,), for those who discount them."""
        return None

    def _set_maxima(self, maxima: Array) -> None:
        """Take over the moving maxima from a stage."""

    def _perturbed(self, nodes: Array, sigma: Array) -> Array:
        """Return N perturbed plans and the plan itself, (N + 1, knots + 1, nu); node 0 is being applied."""
        noise = self._noise()
        noise *= np.repeat(sigma[1:, None], nodes.shape[1], axis=1)
        noise += nodes[1:]
        samples = np.empty((self.options.samples + 1, *nodes.shape))
        samples[:, 0], samples[-1] = nodes[0], nodes
        np.clip(noise, -1.0, 1.0, out=samples[:-1, 1:])
        return samples

    def _controls(self, nodes: Array) -> Array:
        """Return controls in the model's units, (n, H + 1, nu), within their range."""
        return self.spline.controls(nodes, self._centre, self._half)

    def _valid(self, returns: Array, failed: NDArray[np.bool_]) -> Array:
        """Return returns with the worst one in place of those that are not finite."""
        failed |= ~np.isfinite(returns)
        if failed.all():
            return np.zeros(len(returns))
        return np.asarray(np.where(failed, np.min(returns[~failed]), returns), dtype=float)

    # ---- from plan to plan

    def _first_guess(self, start: Array) -> Array:
        """Return the plan that holds the joints where they are, or no torque."""
        held = self.hold(start)
        return np.tile(np.clip((held - self._centre) / self._half, -1.0, 1.0), (self.options.knots + 1, 1))

    def _shifted(self, nodes: Array, t: float) -> Array:
        """Return the last plan, seen from time t [s]."""
        elapsed = (t - self._time) / self.dt
        if self.options.shift == "elapsed":
            if not 0 <= elapsed <= self.steps + 1:
                return np.zeros_like(nodes)
            at = np.linspace(0.0, self.steps, self.options.knots + 1) + elapsed
            return np.clip(self.spline.at(at) @ nodes, -1.0, 1.0)
        count = round(elapsed)
        if count < 0 or abs(elapsed - count) > 1e-6:
            raise SamplingError(
                f"plan at t = {t:g} s: is not a whole number of steps after the last one - got {t - self._time:g} s, "
                f"expected a multiple of {self.dt:g} s; call reset() first, or use shift='elapsed'"
            )
        controls = np.zeros((self.steps + 1, nodes.shape[1]))
        if count <= self.steps:
            controls[: self.steps + 1 - count] = (self.spline.to_controls @ nodes)[count:]
        return np.clip(self.spline.to_nodes @ controls, -1.0, 1.0)

    # ---- around it

    def _checked(self, x: ArrayLike) -> Array:
        start: Array = np.asarray(x, dtype=float)
        nx = self.model.state.nx
        if start.shape != (nx,):
            raise ShapeError(
                f"plan: state has the wrong size - got shape {start.shape}, expected ({nx},); build it with "
                "model.state()"
            )
        if not np.all(np.isfinite(start)):
            bad = np.flatnonzero(~np.isfinite(start)).tolist()
            raise SamplingError(f"plan: state is not finite - got NaN or infinity at entries {bad}, expected numbers; "
                                "look at what measured it")  # fmt: skip
        return start

    def _report(self, t: float, nodes: Array, rolled: Rolled, seconds: dict[str, float]) -> Plan:
        controls = self._controls(nodes[None])[0]
        return Plan(
            time=t,
            action=controls[0],
            controls=controls,
            weights=rolled.weights,
            returns=rolled.returns,
            effective_samples=float(1.0 / np.sum(rolled.weights**2)),
            failed=int(rolled.failed.sum()),
            states=rolled.states,
            cost=rolled.cost,
            violation=rolled.violation,
            missed=self._missed(rolled),
            seconds=dict(seconds),
        )

    def _missed(self, rolled: Rolled) -> dict[str, float]:
        """Return the mean violation of each constraint by weight, of its worst row in every step."""
        names, rows = np.array(self.constraints), rolled.violation.transpose(0, 2, 1)  # as they lie in memory
        return {
            name: float(np.mean(rows[names == name].max(axis=0) @ rolled.weights))
            for name in dict.fromkeys(self.constraints)
        }


@dataclass(eq=False)
class Rolled:
    """The roll-outs of a stage.

    Args:
        k: index of the first node.
        states: (n, H + 2, nx).
        cost: running costs (n, H + 1).
        last: cost of terms ``at="end"``, (n,); None if there are none.
        violation: (nc, n, H + 1).
        failed: which ended in NaN, (n,).
        returns: (n,).
        weights: (n,).
    """

    k: int
    states: Array
    cost: Array
    last: Array | None
    violation: Array
    failed: NDArray[np.bool_]
    returns: Array = field(default_factory=lambda: np.zeros(0))
    weights: Array = field(default_factory=lambda: np.zeros(0))


def softmax(returns: Array, temperature: float) -> Array:
    """Return weights exp((R − R_best) / (λ std R)) that sum to one, (n,); equal returns weigh the same."""
    spread = max(float(np.std(returns)), _SPREAD)
    weights = np.exp((returns - np.max(returns)) / (temperature * spread))
    return np.asarray(weights / weights.sum())


def _lap(seconds: dict[str, float], part: str, began: float) -> float:
    """Add the time since ``began`` to a part, and return now."""
    now = time.perf_counter()
    seconds[part] += now - began
    return now


def _simulated(problem: Problem) -> Mujoco:
    """Return the MuJoCo model that a problem is scheduled on."""
    segment = problem.schedule.segments[0]
    if not isinstance(segment.model, Mujoco):
        raise SamplingError(
            f"schedule ({segment.source}): its model cannot be rolled out - got {type(segment.model).__name__} "
            f"'{segment.model.name}', expected models.Mujoco(robot); schedule one"
        )
    return segment.model


def _horizon(problem: Problem, dt: float) -> int:
    """Return H of a problem's schedule."""
    segment = problem.schedule.segments[0]
    if segment.duration is None:
        raise SamplingError(
            f"schedule ({segment.source}): has no horizon - got until_end, expected a duration; write "
            f"model.over(duration, dt={dt:g})"
        )
    return whole_steps(segment.duration, dt, f"schedule ({segment.source})")
