"""The value network as a Flax module, for learning, and its conversion to and from NumPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from numpy.typing import NDArray

from ..value import EPSILON, HIDDEN, Layer, Network, Single


class Hidden(nnx.Module):  # type: ignore[misc]  # Flax is not followed
    """Dense → ELU → LayerNorm."""

    def __init__(self, inputs: int, outputs: int, *, rngs: nnx.Rngs) -> None:
        self.dense = nnx.Linear(inputs, outputs, rngs=rngs)
        self.norm = nnx.LayerNorm(outputs, epsilon=EPSILON, rngs=rngs)

    def __call__(self, x: jax.Array) -> jax.Array:
        """Return the layer's outputs, (n, outputs)."""
        return self.norm(nnx.elu(self.dense(x)))


class ValueModule(nnx.Module):  # type: ignore[misc]  # Flax is not followed
    """The value of normalised inputs: hidden layers and one output, which softplus makes positive."""

    def __init__(self, inputs: int, hidden: tuple[int, ...] = HIDDEN, *, rngs: nnx.Rngs) -> None:
        self.count = len(hidden)
        for i, (before, after) in enumerate(zip((inputs, *hidden), hidden, strict=False)):
            setattr(self, f"hidden{i}", Hidden(before, after, rngs=rngs))
        self.head = nnx.Linear(hidden[-1] if hidden else inputs, 1, rngs=rngs)

    def __call__(self, x: jax.Array) -> jax.Array:
        """Return the values of inputs (n, m), (n,)."""
        for i in range(self.count):
            x = getattr(self, f"hidden{i}")(x)
        return nnx.softplus(self.head(x)[..., 0])


def to_network(module: ValueModule, mean: NDArray[Any], std: NDArray[Any]) -> Network:
    """Return a module's parameters as a network for NumPy.

    Args:
        module: the module.
        mean: mean of the inputs, (m,).
        std: standard deviation of the inputs, (m,).
    """
    layers = []
    for i in range(module.count):
        hidden = getattr(module, f"hidden{i}")
        layers.append(
            Layer(*map(_single, (hidden.dense.kernel, hidden.dense.bias, hidden.norm.scale, hidden.norm.bias)))
        )
    head, bias = _single(module.head.kernel), _single(module.head.bias)
    return Network(_single(mean), _single(std), tuple(layers), head[:, 0], float(bias[0]))


def to_module(network: Network) -> ValueModule:
    """Return a network's parameters as a module; its inputs are still to be normalised."""
    module = ValueModule(network.num_inputs, network.hidden, rngs=nnx.Rngs(0))
    for i, layer in enumerate(network.layers):
        hidden = getattr(module, f"hidden{i}")
        hidden.dense.kernel[...], hidden.dense.bias[...] = jnp.asarray(layer.kernel), jnp.asarray(layer.bias)
        hidden.norm.scale[...], hidden.norm.bias[...] = jnp.asarray(layer.scale), jnp.asarray(layer.offset)
    module.head.kernel[...] = jnp.asarray(network.head)[:, None]
    module.head.bias[...] = jnp.full(1, network.head_bias, dtype=jnp.float32)
    return module


def compiled(network: Network) -> Callable[[Any], jax.Array]:
    """Return the network as a function compiled by JAX, of inputs (n, m) that are not normalised, to values (n,)."""
    graph, parameters = nnx.split(to_module(network))
    mean, std = jnp.asarray(network.mean), jnp.asarray(network.std)

    def value(inputs: jax.Array) -> jax.Array:
        return nnx.merge(graph, parameters)((inputs - mean) / std)

    jitted: Callable[[Any], jax.Array] = jax.jit(value)
    return jitted


def _single(values: Any) -> Single:
    return np.array(values[...] if isinstance(values, nnx.Variable) else values, dtype=np.float32)
