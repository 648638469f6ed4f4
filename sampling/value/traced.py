"""A value function as JAX operations, for use within ``jit``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SamplingError
from piaffe.ocp import LoweredMode, Nodes

from ..translate import import_jax, translate
from .inputs import targets
from .network import EPSILON, Network
from .store import Value

Array = NDArray[np.float64]


def traced_value(value: Any, mode: LoweredMode) -> Callable[[Any, Any], Any]:
    """Return V as a function of states (n, nx) and the numbers of their node, traced by JAX; it is 0 after a fall.

    Args:
        value: a :class:`piaffe.sampling.value.Value`.
        mode: the lowered mode of the problem.

    Raises:
        SamplingError: the value is not a :class:`piaffe.sampling.value.Value`.
    """
    if not isinstance(value, Value):
        raise SamplingError(
            f"device stage: value cannot be compiled - got {type(value).__name__}, expected a value that Piaffe "
            'learnt; choose engine="native"'
        )
    jnp = import_jax().numpy
    inputs, places = translate(value.inputs.function(mode)), _places(value)

    def values(states: Any, numbers: Any) -> Any:
        (rows,) = inputs(states, numbers)
        fallen = jnp.zeros(len(states), dtype=bool)
        if "ground normal" in places and "tilt" in value.fall:
            fallen |= rows[:, places["ground normal"] + 2] < np.cos(value.fall["tilt"])
        if "base height" in places and "height" in value.fall:
            fallen |= rows[:, places["base height"]] < value.fall["height"]
        return jnp.where(fallen, 0.0, _network(value.network, rows))

    return values


def numbers_of(nodes: Nodes, k: int) -> Array:
    """Return the numbers of node k that the inputs of a value need besides the state: parameters and targets."""
    return np.concatenate([nodes.running(k, 1).p[0], targets(nodes, k)])


def _places(value: Value) -> dict[str, int]:
    """Return the index of the first row of each input."""
    sizes = value.made_for["inputs"]
    return dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))


def _network(network: Network, inputs: Any) -> Any:
    """Return a network's values of inputs (n, m), (n,)."""
    jax = import_jax()
    jnp, nn = jax.numpy, jax.nn
    x = (inputs - network.mean) / network.std
    for layer in network.layers:
        x = nn.elu(x @ jnp.asarray(layer.kernel) + layer.bias)
        centred = x - x.mean(axis=1, keepdims=True)
        spread = jnp.sqrt((centred**2).mean(axis=1, keepdims=True) + EPSILON)
        x = layer.scale * centred / spread + layer.offset
    return nn.softplus(x @ jnp.asarray(network.head) + network.head_bias)
