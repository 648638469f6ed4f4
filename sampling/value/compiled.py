"""The value network in C on several threads, if a C compiler works."""

from __future__ import annotations

import ctypes as ct
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from piaffe.codegen import c_library, pointer

from .network import EPSILON, Network, Single

_BLOCK = 48  # rows; the same as BLOCK in network.c
_SHARE = 128  # least number of rows per thread: to start a thread's work takes time, too


def compiled_network(network: Network, *, threads: int | None = None) -> Callable[[ArrayLike], Single]:
    """Return a network as a function of inputs (n, m) to values (n,), in C if possible.

    The function is the network itself (NumPy) if no compiler works, or if the size of a hidden layer is not a multiple
    of the tile's size on this processor.

    Args:
        network: the network.
        threads: number of threads that the rows are divided among; one per core by default.
    """
    library = _library()
    if library is None or not network.layers or any(size % library.piaffe_value_tile() for size in network.hidden):
        return network
    return CompiledNetwork(network, library, threads or os.cpu_count() or 1)


class CompiledNetwork:
    """A network in C. Only one thread may call it at a time.

    Args:
        network: the network.
        library: compiled library with the function ``piaffe_value``.
        threads: number of threads that the rows are divided among.
    """

    def __init__(self, network: Network, library: ct.CDLL, threads: int) -> None:
        tile = library.piaffe_value_tile()
        *hidden, head = network.folded
        self._network, self._run, self._threads = network, library.piaffe_value, threads
        self._kernels = [_tiled(kernel, tile) for kernel, _ in hidden]
        self._biases = [np.ascontiguousarray(bias) for _, bias in hidden]
        self._head, self._head_bias = np.ascontiguousarray(head[0][:, 0]), float(head[1][0])
        self._sizes = np.array([network.num_inputs, *network.hidden], dtype=np.intc)
        self._largest = int(self._sizes.max())
        self._work = [np.empty(2 * _BLOCK * self._largest, dtype=np.float32) for _ in range(threads)]
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None

    def __call__(self, inputs: ArrayLike) -> Single:
        """Return the values of inputs (n, m), (n,).

        Raises:
            ShapeError: the inputs are not (n, m).
        """
        x = np.ascontiguousarray(self._network.checked(inputs))
        values = np.empty(len(x), dtype=np.float32)
        count = max(1, min(self._threads, len(x) // _SHARE))
        ends = [len(x) * i // count for i in range(count + 1)]
        shares = [(i, slice(first, last)) for i, (first, last) in enumerate(pairwise(ends))]

        def run(share: tuple[int, slice]) -> None:
            thread, part = share
            self._run(
                pointer(x[part]), ct.c_long(len(x[part])), ct.c_int(len(self._kernels)), pointer(self._sizes),
                _pointers(self._kernels), _pointers(self._biases), pointer(self._head), ct.c_float(self._head_bias),
                ct.c_float(EPSILON), pointer(self._work[thread]), ct.c_int(self._largest), pointer(values[part]),
            )  # fmt: skip

        own, *others = shares
        started = [self._pool.submit(run, share) for share in others] if self._pool is not None else []
        run(own)
        for each in started:
            each.result()
        return values


def _tiled(kernel: Single, tile: int) -> Single:
    """Return a kernel (m, n) in tiles of columns, (n / tile, m, tile)."""
    m, n = kernel.shape
    return np.ascontiguousarray(kernel.reshape(m, n // tile, tile).transpose(1, 0, 2))


def _pointers(arrays: list[Single]) -> ct.Array[ct.c_void_p]:
    return (ct.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))


@lru_cache(maxsize=1)
def _library() -> ct.CDLL | None:
    loaded = c_library("piaffe.sampling.value", "network", "value networks")
    if loaded is not None:
        loaded.piaffe_value.restype = None
        loaded.piaffe_value_tile.restype = ct.c_int
    return loaded
