"""A stage of a plan as one compiled function on the device. Only the plan and the data for reports are copied back."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SamplingError
from piaffe.ocp import NodeNumbers

from ..engines import MjxEngine
from ..translate import import_jax
from ..value import numbers_of, traced_value
from .contract import require_explained, require_sound, returned, sampled, settled, unexplained, updated
from .horizon import centre_and_half_range
from .host_stage import Seconds, lap
from .stage import Memory, Rolled, Stage, Staged, Staging

Array = NDArray[np.float64]


class DeviceStage:
    """The stage of :class:`HostStage` as one compiled function: samples, roll-outs, cost, value, returns and update.

    The methods of the sampler are traced with ``xp = jax.numpy``. The first call of each size compiles code for it,
    which takes a minute. Parts cannot be timed separately, so the whole time counts as ``roll_out``.

    Args:
        controller: a controller with ``engine="mjx"``.

    Raises:
        SamplingError: the controller has another engine, or its value cannot be compiled by JAX.
    """

    def __init__(self, controller: Staging) -> None:
        engine = controller.engine
        if not isinstance(engine, MjxEngine):
            raise SamplingError(
                f"device stage: engine - got {type(engine).__name__}, expected MjxEngine; make the controller with "
                'engine="mjx"'
            )
        self._jax = import_jax()
        self._controller, self._engine = controller, engine
        self._centre, self._half = centre_and_half_range(controller.model)
        self._ends = bool(controller.nodes.mode.rows["terminal_residual"])
        with engine.computing():
            self._value = None if controller.value is None else traced_value(controller.value, controller.nodes.mode)
            self._run = self._jax.jit(self._stage)

    def __call__(
        self,
        start: Array,
        plan: Array,
        noise: Array,
        stage: Stage,
        memory: Memory,
        k: int,
        numbers: NodeNumbers,
        seconds: Seconds,
    ) -> Staged:
        """Return a stage's plan, roll-outs and weights as arrays of NumPy; the memory remains on the device.

        Args:
            start: state (nx,).
            plan: the current plan, nodes (knots + 1, nu), scaled to [-1, 1].
            noise: standard normal numbers (N, knots + 1, nu), zero at node 0.
            stage: index and deviations of the stage.
            memory: memory of the sampler.
            k: index of the first node.
            numbers: parameters, weights and masks of nodes k … k + H.
            seconds: computing times; the time of the stage is added to them.

        Raises:
            SamplingError: a method returns a wrong shape or NaN, or cannot be traced.
        """
        began = time.perf_counter()
        own, dtype = self._controller, self._engine.dtype
        last = k + own.steps + 1
        end = own.nodes.end(last)
        given = {
            "start": start,
            "plan": plan,
            "noise": noise,
            "deviation": stage.deviation,
            "memory": dict(memory),
            "numbers": (numbers.p, numbers.weight, numbers.g_mask, numbers.h_mask),
            "end": (end.p[0], end.weight[0], end.g_mask[0], end.h_mask[0]),
            "seen": np.zeros(0) if self._value is None else numbers_of(own.nodes, last),
        }
        with self._engine.computing():
            cast = self._jax.tree.map(lambda number: self._jax.numpy.asarray(number, dtype), given)
            staged, odd = self._run(cast, stage.index, stage.count, k)
            here: Staged = self._jax.tree.map(np.array, staged._replace(memory={}))
        require_explained(own, np.asarray(odd))
        here = here._replace(memory=staged.memory)
        require_sound(own, here)
        lap(seconds, "roll_out", began)
        return here

    # ---- on the device

    def _stage(self, given: dict[str, Any], index: Any, count: Any, k: Any) -> tuple[Staged, Any]:
        """Return the result of a stage, and which returns are not finite without a reason, (n,)."""
        jax, jnp, own = self._jax, self._jax.numpy, self._controller
        memory, plan = given["memory"], given["plan"]
        stage = Stage(index, count, given["deviation"])
        samples = sampled(own, jnp, plan, given["noise"], stage, memory)
        share = jnp.clip(jnp.einsum("hj,njc->nhc", self._fixed(own.spline.to_controls), samples), -1, 1)
        controls = self._fixed(self._centre) + self._fixed(self._half) * share
        states, failed = jax.vmap(self._engine.states, (None, 0))(given["start"], controls)
        cost, violation = own.evaluator.stage(states[:, :-1], controls, *given["numbers"])
        final = states[:, -1]
        last = own.evaluator.terminal(final, *given["end"])[0] if self._ends else None
        value = None if self._value is None else self._value(final, given["seen"])
        rolled = Rolled(k, states, controls, cost, last, value, violation, failed)
        found, memory = returned(own, jnp, rolled, memory)
        returns, failed = settled(jnp, found, failed)
        plan, weights, memory = updated(own, jnp, samples, returns, memory)
        staged = Staged(plan, rolled._replace(failed=failed), returns, weights, memory)
        return staged, unexplained(jnp, found, rolled)

    def _fixed(self, values: Array) -> Any:
        return self._jax.numpy.asarray(values, self._engine.dtype)
