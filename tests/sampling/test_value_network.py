from itertools import pairwise

import numpy as np
import pytest

from piaffe.errors import ShapeError
from piaffe.sampling.value.compiled import CompiledNetwork, compiled_network
from piaffe.sampling.value.network import EPSILON, Layer, Network


def make(sizes: tuple[int, ...] = (7, 24, 16), seed: int = 0) -> Network:
    rng = np.random.default_rng(seed)

    def draw(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape).astype(np.float32)

    layers = tuple(Layer(draw(m, n) / np.float32(np.sqrt(m)), draw(n), draw(n), draw(n)) for m, n in pairwise(sizes))
    return Network(
        3 * draw(sizes[0]), np.exp(draw(sizes[0])), layers, draw(sizes[-1]) / np.float32(np.sqrt(sizes[-1])), 0.3
    )


def as_written(network: Network, inputs: np.ndarray) -> np.ndarray:
    x = (inputs - network.mean.astype(float)) / network.std
    for layer in network.layers:
        x = x @ layer.kernel.astype(float) + layer.bias
        x = np.where(x > 0, x, np.expm1(np.minimum(x, 0)))
        x = (x - x.mean(axis=1, keepdims=True)) / np.sqrt(x.var(axis=1, keepdims=True) + EPSILON)
        x = x * layer.scale + layer.offset
    return np.logaddexp(0.0, x @ network.head.astype(float) + network.head_bias)


def inputs_for(network: Network, rows: int = 200) -> np.ndarray:
    rng = np.random.default_rng(1)
    return network.mean + network.std * rng.standard_normal((rows, network.num_inputs))


@pytest.mark.parametrize("sizes", [(7, 24, 16), (50, 512, 256, 128), (3, 1), (4, 8)])
def test_network_is_what_its_docstring_says(sizes: tuple[int, ...]) -> None:
    network = make(sizes)
    inputs = inputs_for(network)
    expected = as_written(network, inputs)
    np.testing.assert_allclose(network(inputs), expected, rtol=1e-5, atol=2e-5)


def test_value_is_never_negative_nor_overflows() -> None:
    network = make()
    values = network(1e4 * inputs_for(network))
    assert np.all(np.isfinite(values))
    assert np.all(values >= 0)


def test_rows_are_independent_of_the_others() -> None:
    network = make()
    inputs = inputs_for(network)
    np.testing.assert_allclose(network(inputs)[:5], network(inputs[:5]), rtol=1e-5)


def test_network_as_arrays_and_back() -> None:
    network = make()
    again = Network.from_arrays(network.arrays())
    assert again.hidden == (24, 16)
    np.testing.assert_array_equal(again(inputs_for(network)), network(inputs_for(network)))


@pytest.mark.parametrize("rows", [1, 7, 64, 200, 513])
def test_network_in_c_is_the_one_in_numpy(rows: int) -> None:
    network = make((50, 512, 256, 128))
    inputs = inputs_for(network, rows)
    for threads in (1, 2, 3):
        values = compiled_network(network, threads=threads)(inputs)
        np.testing.assert_allclose(values, as_written(network, inputs), rtol=1e-5, atol=1e-5)


def test_network_in_c_keeps_rows_that_are_no_numbers_to_themselves() -> None:
    network = make((7, 64, 32))
    compiled = compiled_network(network)
    inputs = inputs_for(network, 20)
    expected = compiled(inputs)
    inputs[3, 2], inputs[8, 0] = np.nan, 1e5
    values = compiled(inputs)
    assert isinstance(compiled, CompiledNetwork)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(values)), [3])
    others = np.setdiff1d(np.arange(20), [3, 8])
    np.testing.assert_array_equal(values[others], expected[others])


def test_layers_that_fill_no_tile_stay_in_numpy() -> None:
    network = make((7, 24, 5))
    assert compiled_network(network) is network


def test_wrong_number_of_inputs_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"got \(4, 6\), expected \(n, 7\)"):
        make()(np.zeros((4, 6)))
    with pytest.raises(ShapeError, match=r"got \(4, 6\), expected \(n, 7\)"):
        compiled_network(make((7, 64)))(np.zeros((4, 6)))


def test_numpy_flax_and_compiled_network_agree() -> None:
    pytest.importorskip("flax")
    from piaffe.sampling.learning.modules import compiled, to_module, to_network

    network = make((50, 512, 256, 128))
    inputs = inputs_for(network, 512).astype(np.float32)
    module = to_module(network)
    values = network(inputs)
    np.testing.assert_allclose(np.asarray(compiled(network)(inputs)), values, rtol=1e-5, atol=1e-5)
    again = to_network(module, network.mean, network.std)
    np.testing.assert_array_equal(again(inputs), values)
