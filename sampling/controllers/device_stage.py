"""A stage of a plan as one function on the device: nothing but the plan and what is reported leaves it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SamplingError
from piaffe.ocp import NodeNumbers

from ..engines import MjxEngine
from ..translate import import_jax
from ..value import numbers_of, traced_value

if TYPE_CHECKING:
    from .mppi import MPPI

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Staged:
    """A stage's result; arrays are JAX's, still on the device.

    Args:
        nodes: the plan, Σ w_n samples_n, (knots + 1, nu).
        states: (n, H + 2, nx).
        cost: running costs (n, H + 1).
        violation: (nc, n, H + 1).
        failed: (n,).
        returns: (n,), the worst one where failed.
        weights: (n,), their sum is one.
        maxima: moving maximum of each violation, (nc,); empty without constraint discounting.
    """

    nodes: Any
    states: Any
    cost: Any
    violation: Any
    failed: Any
    returns: Any
    weights: Any
    maxima: Any


class DeviceStage:
    """Roll-out, cost, discount, value and softmax of a controller's stage, compiled as one.

    A stage is what :class:`MPPI` computes in NumPy from given samples, with the discount and the value of
    :class:`TDCDMPPI` if the controller has them. The first call of a size compiles for it, which takes a minute.

    Args:
        controller: one with ``engine="mjx"``.
        spread: least standard deviation of the returns.

    Raises:
        SamplingError: the controller's engine is another one, or its value has no form in JAX.
    """

    def __init__(self, controller: MPPI, *, spread: float = 1e-6) -> None:
        if not isinstance(controller.engine, MjxEngine):
            raise SamplingError(
                f"fused stage: engine - got {type(controller.engine).__name__}, expected MjxEngine; make the "
                'controller with engine="mjx"'
            )
        self._jax = import_jax()
        self._controller, self._engine, self._spread = controller, controller.engine, spread
        action = controller.model.action
        self._centre, self._half = 0.5 * (action.upper + action.lower), 0.5 * (action.upper - action.lower)
        self._ends = bool(controller.nodes.mode.rows["terminal_residual"])
        self._discount = getattr(controller, "discount", None)
        own = getattr(controller, "value", None)
        with self._engine.computing():
            self._value = None if own is None else traced_value(own, controller.nodes.mode)
            self._run = self._jax.jit(self._stage)

    def __call__(
        self, start: Array, samples: Array, k: int, numbers: NodeNumbers, maxima: Array | None = None
    ) -> Staged:
        """Return a stage's plan and what it was made from.

        Args:
            start: state (nx,).
            samples: plans to try, nodes in halves of the controls' range, (n, knots + 1, nu).
            k: index of the first node.
            numbers: of nodes k … k + H.
            maxima: moving maxima of the violations so far, (nc,); None at the first stage.
        """
        controller, dtype = self._controller, self._engine.dtype
        last = k + controller.steps + 1
        end = controller.nodes.end(last)
        given = {
            "start": start,
            "samples": samples,
            "numbers": (numbers.p, numbers.weight, numbers.g_mask, numbers.h_mask),
            "end": (end.p[0], end.weight[0], end.g_mask[0], end.h_mask[0]),
            "seen": np.zeros(0) if self._value is None else numbers_of(controller.nodes, last),
            "before": np.zeros(len(controller.constraints)) if maxima is None else maxima,
            "rate": 1.0 if maxima is None else controller.options.violation_rate,
        }
        with self._engine.computing():
            return Staged(**self._run(self._jax.tree.map(lambda number: np.asarray(number, dtype), given)))

    # ---- on the device

    def _stage(self, given: dict[str, Any]) -> dict[str, Any]:
        jax, jnp, controller = self._jax, self._jax.numpy, self._controller
        controls = jnp.clip(
            jnp.einsum("hj,njc->nhc", self._fixed(controller.spline.to_controls), given["samples"]), -1, 1
        )
        controls = self._fixed(self._centre) + self._fixed(self._half) * controls
        states, failed = jax.vmap(self._engine.states, (None, 0))(given["start"], controls)
        cost, violation = controller.evaluator.stage(states[:, :-1], controls, *given["numbers"])
        returns, maxima = self._returns(given, states[:, -1], cost, violation, failed)
        failed = failed | ~jnp.isfinite(returns)
        worst = jnp.where(failed.all(), 0.0, jnp.min(jnp.where(failed, jnp.inf, returns)))
        returns = jnp.where(failed, worst, returns)
        spread = jnp.maximum(jnp.std(returns), self._spread)
        weights = jax.nn.softmax(returns / (controller.options.temperature * spread))
        return {
            "nodes": jnp.einsum("n,njc->jc", weights, given["samples"]), "states": states, "cost": cost,
            "violation": violation, "failed": failed, "returns": returns, "weights": weights, "maxima": maxima,
        }  # fmt: skip

    def _returns(self, given: dict[str, Any], final: Any, cost: Any, violation: Any, failed: Any) -> tuple[Any, Any]:
        """Return the returns (n,) and the violations' moving maxima (nc,)."""
        jnp, controller = self._jax.numpy, self._controller
        reward, end = jnp.exp(-cost / controller.reward.scale), None
        if self._ends:
            last, _ = controller.evaluator.terminal(final, *given["end"])
            end = jnp.exp(-last / controller.reward.scale)
        if self._discount is None:
            mean = reward.mean(axis=1) if end is None else (reward.sum(axis=1) + end) / (reward.shape[1] + 1)
            return mean, jnp.zeros(0)
        if self._value is not None:
            end = self._value(final, given["seen"])
        largest = jnp.max(jnp.where(failed[:, None], 0.0, violation), axis=(1, 2), initial=0.0)
        maxima = given["before"] + given["rate"] * (largest - given["before"])
        share = self._fixed(self._discount.p_max)[:, None, None]
        scaled = violation / jnp.maximum(maxima, controller.options.violation_floor)[:, None, None]
        delta = jnp.max(share * jnp.clip(scaled, 0.0, 1.0), axis=0, initial=0.0)
        kept = jnp.cumprod(controller.options.discount * (1.0 - delta), axis=1)
        total = (kept * reward).sum(axis=1)
        return (total if end is None else total + kept[:, -1] * end), maxima

    def _fixed(self, values: Array) -> Any:
        return self._jax.numpy.asarray(values, self._engine.dtype)
