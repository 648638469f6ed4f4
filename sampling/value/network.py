"""The value network in NumPy, which evaluates it without JAX."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ShapeError

Array = NDArray[np.float64]
Single = NDArray[np.float32]

EPSILON = 1e-6  # added to the variance in a layer normalisation
HIDDEN = (512, 256, 128)
_LAYER = ("kernel", "bias", "scale", "offset")


@dataclass(frozen=True, eq=False)
class Layer:
    """A hidden layer, ``LayerNorm(ELU(x kernel + bias))``.

    Args:
        kernel: weights, (m, n).
        bias: (n,).
        scale: scale of the normalisation, (n,).
        offset: offset of the normalisation, (n,).
    """

    kernel: Single
    bias: Single
    scale: Single
    offset: Single


@dataclass(frozen=True, eq=False)
class Network:
    """V = softplus(head · LayerNorm(ELU(…)) + head_bias) of normalised inputs (x − mean) / std, in float32.

    Args:
        mean: mean of the inputs, (m,).
        std: standard deviation of the inputs, (m,), positive.
        layers: the hidden layers.
        head: weights of the output layer, (n,).
        head_bias: bias of the output layer.
    """

    mean: Single
    std: Single
    layers: tuple[Layer, ...]
    head: Single
    head_bias: float

    def check(self, inputs: int) -> None:
        """Raise ValueError unless all arrays fit each other and these inputs, and are finite.

        Args:
            inputs: number of inputs.
        """
        expected: dict[str, tuple[int, ...]] = {"mean": (inputs,), "std": (inputs,)}
        size = inputs
        for i, layer in enumerate(self.layers):
            width = layer.bias.size
            expected |= {f"{i}/kernel": (size, width), **{f"{i}/{name}": (width,) for name in _LAYER[1:]}}
            size = width
        expected |= {"head": (size,), "head_bias": (1,)}
        for name, values in self.arrays().items():
            if values.shape != expected[name]:
                raise ValueError(f"'{name}' {values.shape} in place of {expected[name]}")
            if not np.all(np.isfinite(values)):
                raise ValueError(f"'{name}' with a number that is not finite")
        if not np.all(self.std > 0):
            raise ValueError("'std' with a number that is not positive")

    @property
    def num_inputs(self) -> int:
        """Number of inputs m."""
        return len(self.mean)

    @property
    def hidden(self) -> tuple[int, ...]:
        """Sizes of the hidden layers."""
        return tuple(len(layer.bias) for layer in self.layers)

    def __call__(self, inputs: ArrayLike) -> Single:
        """Return the values of inputs (n, m), (n,), not negative.

        Raises:
            ShapeError: the inputs are not (n, m).
        """
        return self._folded(self.checked(inputs))

    def checked(self, inputs: ArrayLike) -> Single:
        """Return inputs (n, m) in single precision; raise ShapeError if they are not."""
        x = np.asarray(inputs, dtype=np.float32)
        if x.ndim != 2 or x.shape[1] != self.num_inputs:
            raise ShapeError(
                f"value network: inputs have the wrong shape - got {x.shape}, expected (n, {self.num_inputs}); give "
                "one row per state"
            )
        return x

    @property
    def folded(self) -> list[tuple[Single, Single]]:
        """Kernel and bias of each layer and of the head, with the affine map before them and the mean folded in."""
        return list(zip(self._folded.kernels, self._folded.biases, strict=True))

    @cached_property
    def _folded(self) -> _Folded:
        return _Folded(self)

    # ---- as flat arrays, for files

    def arrays(self) -> dict[str, Single]:
        """Return all parameters as arrays by name."""
        flat = {"mean": self.mean, "std": self.std, "head": self.head}
        flat["head_bias"] = np.array([self.head_bias], dtype=np.float32)
        for i, layer in enumerate(self.layers):
            flat |= {f"{i}/{name}": getattr(layer, name) for name in _LAYER}
        return flat

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Network:
        """Return the network with the arrays that :meth:`arrays` returned."""
        held = {name: np.ascontiguousarray(value, dtype=np.float32) for name, value in arrays.items()}
        count = sum(name.endswith("/kernel") for name in held)
        layers = tuple(Layer(**{name: held[f"{i}/{name}"] for name in _LAYER}) for i in range(count))
        return cls(held["mean"], held["std"], layers, held["head"], float(held["head_bias"][0]))


class _Folded:
    """The network with all affine maps folded into the next matrix product, and with work arrays that are kept.

    A layer normalisation subtracts the mean of a row. To subtract it from the columns of the next kernel instead gives
    the same result. Then 1 + ELU(x) = max(x + 1, exp(min(x, 0))) gives the same result as ELU(x), because they differ
    by a constant.
    """

    def __init__(self, network: Network) -> None:
        scale, offset = 1.0 / network.std.astype(float), -network.mean / network.std.astype(float)
        self.kernels: list[Single] = []
        self.biases: list[Single] = []
        for i, layer in enumerate(network.layers):
            self._fold(layer.kernel, layer.bias, scale, offset, is_first=i == 0)
            scale, offset = layer.scale.astype(float), layer.offset.astype(float)
        self._fold(network.head[:, None], np.array([network.head_bias]), scale, offset, is_first=not network.layers)
        self.averages = [np.full(k.shape[1], 1 / k.shape[1], dtype=np.float32) for k in self.kernels]
        self._work: dict[int, list[tuple[Single, Single]]] = {}

    def _fold(self, kernel: Single, bias: NDArray[np.floating], scale: Array, offset: Array, *, is_first: bool) -> None:
        exact = kernel.astype(float)
        folded = scale[:, None] * exact
        if not is_first:
            folded -= folded.mean(axis=0)
        self.kernels.append(folded.astype(np.float32))
        self.biases.append((bias + offset @ exact).astype(np.float32))

    def __call__(self, inputs: Single) -> Single:
        n = len(inputs)
        if n not in self._work:
            pairs = [(np.empty((n, len(b)), np.float32), np.empty((n, len(b)), np.float32)) for b in self.biases[:-1]]
            self._work = {n: pairs}  # only one size is kept: a planner uses the same number of rows each time
        y, inverse = inputs, np.ones((n, 1), dtype=np.float32)
        for i, (z, e) in enumerate(self._work[n]):
            np.dot(y, self.kernels[i], out=z)
            if i:
                z *= inverse
            z += self.biases[i]
            np.minimum(z, 0.0, out=e)
            np.exp(e, out=e)
            z += 1.0
            np.maximum(z, e, out=z)
            mean = z @ self.averages[i]
            variance = np.einsum("ij,ij->i", z, z) / np.float32(z.shape[1]) - mean * mean
            inverse = (1.0 / np.sqrt(np.maximum(variance, 0.0) + np.float32(EPSILON)))[:, None]
            y = z
        last = (y @ self.kernels[-1]) * inverse + self.biases[-1]
        return np.asarray(np.logaddexp(np.float32(0.0), last[:, 0]))
