"""TD(0) with a target network, offline, on transitions of the constraint-discounted controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import nnx
from numpy.typing import NDArray

from ..value import Network
from .checkpoints import Checkpoints
from .modules import ValueModule, to_network
from .options import LearnOptions
from .transitions import NEGLIGIBLE, Transitions

Array = NDArray[np.float64]
Listener = Callable[[int, int, dict[str, float]], None]

CURVES = ("update", "loss", "mean_value", "held_out_error", "explained_variance")
_PROBED = 8192  # transitions whose mean value is recorded
_LEAST_STD = 1e-3  # inputs that hardly vary are not amplified


@dataclass(frozen=True, eq=False)
class Learned:
    """A learnt value function and its learning curves.

    Args:
        network: the value network.
        curves: by name (R,): ``update``, the number of minibatches; ``loss``, the mean squared TD error of the
            minibatches since the last point; ``mean_value``, of transitions that are learnt from; on held-out episodes
            ``held_out_error``, the mean squared TD error, and ``explained_variance``, of the discounted returns (NaN
            without held-out episodes).
    """

    network: Network
    curves: dict[str, Array]


def learn(
    transitions: Transitions,
    options: LearnOptions | None = None,
    *,
    checkpoints: str | Path | None = None,
    listener: Listener | None = None,
) -> Learned:
    """Learn V(x) = E[γ₀ (1 − δ) (r + V(x'))] by TD(0), V(x') = 0 after a fall.

    A constant reward r without violations has the value γ₀ r / (1 − γ₀). Random numbers depend only on the seed and on
    the number of the minibatch, so an interrupted and resumed run has the same result as one without interruption.

    Args:
        transitions: the data; a share ``held_out`` of their episodes is only used for tests.
        options: see :class:`LearnOptions`.
        checkpoints: folder of checkpoints: one is saved at every point of the curves, and the last one is resumed.
        listener: called at every point with the minibatches so far, all minibatches, and the point of the curves.
    """
    options = options or LearnOptions()
    train, test = transitions.split(options.held_out, options.seed)
    mean = train.inputs.mean(axis=0)
    std = np.maximum(train.inputs.std(axis=0), _LEAST_STD)
    data = _on_device(train, mean, std)
    held_out = None if test is None else _on_device(test, mean, std)
    graph, state = _first(options, train.inputs.shape[1])
    rates = {
        name: jnp.float32(getattr(options, name))
        for name in ("discount", "learning_rate", "target_rate", "weight_decay")
    }
    curves: list[dict[str, float]] = []
    kept = None if checkpoints is None else Checkpoints(checkpoints, options, train)
    if kept is not None:
        state, curves = kept.restore(state)
    try:
        while (done := int(curves[-1]["update"]) if curves else 0) < options.updates:
            count = min(options.record_every, options.updates - done)
            state, loss = _run(graph, options.batch, options.seed, rates, done, done + count, state, data)
            point = {"update": done + count, "loss": float(loss)}
            point |= _measure(graph, rates["discount"], state["online"], data, held_out, test)
            curves.append(point)
            if kept is not None:
                kept.save(done + count, state, curves)
            if listener is not None:
                listener(done + count, options.updates, point)
    finally:
        if kept is not None:
            kept.close()
    network = to_network(nnx.merge(graph, state["online"]), mean, std)
    return Learned(network, {name: np.array([point[name] for point in curves]) for name in CURVES})


def _first(options: LearnOptions, inputs: int) -> tuple[Any, dict[str, Any]]:
    """Return the module's structure, and the first state: online and target parameters, and the optimiser's state."""
    graph, parameters = nnx.split(ValueModule(inputs, options.hidden, rngs=nnx.Rngs(options.seed)))
    target = jax.tree.map(jnp.array, parameters)
    return graph, {
        "online": parameters,
        "target": target,
        "optimiser": optax.adamw(options.learning_rate).init(parameters),
    }


def _on_device(transitions: Transitions, mean: Array, std: Array) -> dict[str, jax.Array]:
    columns = {
        "inputs": (transitions.inputs - mean) / std,
        "next_inputs": (transitions.next_inputs - mean) / std,
        "rewards": transitions.rewards,
        "delta": transitions.delta,
        "goes_on": 1.0 - transitions.done,
    }
    return {name: jnp.asarray(values, dtype=jnp.float32) for name, values in columns.items()}


def _targets(graph: Any, discount: jax.Array, parameters: Any, rows: dict[str, jax.Array]) -> jax.Array:
    """Return γ₀ (1 − δ) (r + V(x'))."""
    following = nnx.merge(graph, parameters)(rows["next_inputs"]) * rows["goes_on"]
    return discount * (1.0 - rows["delta"]) * (rows["rewards"] + following)


@partial(jax.jit, static_argnums=(0, 1), donate_argnums=6)
def _run(
    graph: Any,
    batch: int,
    seed: int,
    rates: dict[str, jax.Array],
    first: int,
    last: int,
    state: dict[str, Any],
    data: dict[str, jax.Array],
) -> tuple[dict[str, Any], jax.Array]:
    """Return the state after minibatches ``first`` to ``last - 1``, and their mean loss."""
    optimiser = optax.adamw(rates["learning_rate"], weight_decay=rates["weight_decay"])
    total = data["rewards"].shape[0]

    def loss_of(online: Any, rows: dict[str, jax.Array], targets: jax.Array) -> jax.Array:
        return jnp.mean((nnx.merge(graph, online)(rows["inputs"]) - targets) ** 2)

    def update(number: jax.Array, carried: tuple[dict[str, Any], jax.Array]) -> tuple[dict[str, Any], jax.Array]:
        state, losses = carried
        chosen = jax.random.randint(jax.random.fold_in(jax.random.key(seed), number), (batch,), 0, total)
        rows = {name: values[chosen] for name, values in data.items()}
        targets = _targets(graph, rates["discount"], state["target"], rows)
        loss, gradient = jax.value_and_grad(loss_of)(state["online"], rows, targets)
        changes, moments = optimiser.update(gradient, state["optimiser"], state["online"])
        online = optax.apply_updates(state["online"], changes)
        target = optax.incremental_update(online, state["target"], rates["target_rate"])
        return {"online": online, "target": target, "optimiser": moments}, losses + loss

    state, losses = jax.lax.fori_loop(first, last, update, (state, jnp.float32(0.0)))
    return state, losses / (last - first)


@partial(jax.jit, static_argnums=0)
def _evaluate(
    graph: Any, discount: jax.Array, parameters: Any, data: dict[str, jax.Array]
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the values of the states, the values of the next states, and the mean squared TD error."""
    module = nnx.merge(graph, parameters)
    values = module(data["inputs"])
    error = jnp.mean((values - _targets(graph, discount, parameters, data)) ** 2)
    return values, module(data["next_inputs"]), error


def _measure(
    graph: Any,
    discount: jax.Array,
    parameters: Any,
    data: dict[str, jax.Array],
    held_out: dict[str, jax.Array] | None,
    test: Transitions | None,
) -> dict[str, float]:
    """Return a point of the curves."""
    probe = {name: values[:_PROBED] for name, values in data.items()}
    mean_value = float(_evaluate(graph, discount, parameters, probe)[0].mean())
    point = {"mean_value": mean_value, "held_out_error": float("nan"), "explained_variance": float("nan")}
    if held_out is not None and test is not None:
        values, following, error = _evaluate(graph, discount, parameters, held_out)
        point["held_out_error"] = float(error)
        point["explained_variance"] = explained_variance(
            test, np.asarray(values, dtype=float), np.asarray(following, dtype=float), float(discount)
        )
    return point


def explained_variance(transitions: Transitions, values: Array, following: Array, discount: float) -> float:
    """Return 1 − var(G − V) / var(G) of discounted returns G, for states where G hardly depends on what follows.

    The return after the end of an episode is replaced by the value of the episode's last state. States where its weight
    is above ``NEGLIGIBLE`` are left out.

    Args:
        transitions: T transitions, by episode.
        values: values of the states, (T,).
        following: values of the next states, (T,).
        discount: γ₀.
    """
    returns, weight = transitions.returns(discount)
    last = np.flatnonzero(np.append(np.diff(transitions.episode) != 0, True))
    end = last[np.searchsorted(last, np.arange(len(transitions)))]
    known = weight <= NEGLIGIBLE
    completed = (returns + weight * following[end])[known]
    spread = float(np.var(completed)) if known.any() else 0.0
    return float("nan") if spread == 0.0 else 1.0 - float(np.var(completed - values[known])) / spread
