"""Memory that compiled functions may use, and shares of samples."""

import gc
from itertools import pairwise

import numpy as np
import pytest

from piaffe.codegen import AlignedMemory, aligned_zeros, shares


@pytest.mark.parametrize("count", [0, 1, 7, 8, 1000])
@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.uint8])
def test_arrays_begin_where_vectors_may(count: int, dtype: type) -> None:
    arrays = [aligned_zeros(count, dtype) for _ in range(20)]
    assert count == 0 or all(array.ctypes.data % 64 == 0 for array in arrays)
    assert all(array.shape == (count,) and array.dtype == dtype and not array.any() for array in arrays)
    assert all(array.flags.writeable and array.flags.c_contiguous for array in arrays)


def test_arrays_of_one_memory_share_no_cache_line() -> None:
    memory = AlignedMemory()
    sizes = [0, 1, 8, 9, 2**17 - 3, 40, 2**18, 5]
    arrays = [memory.zeros(size) for size in sizes]
    for i, array in enumerate(arrays):
        assert array.shape == (sizes[i],)
        assert array.size == 0 or array.ctypes.data % 64 == 0
        array[:] = i
    assert all(np.all(array == i) for i, array in enumerate(arrays))
    begins = sorted((array.ctypes.data, array.size) for array in arrays if array.size)
    for (first, size), (second, _) in pairwise(begins):
        assert second >= first + 64 * -(-8 * size // 64)


def test_a_memory_keeps_what_c_points_to() -> None:
    memory = AlignedMemory()
    array = memory.zeros(2**18)
    address, array[0] = array.ctypes.data, 42.0
    del array
    gc.collect()
    [memory.zeros(2**17) for _ in range(4)]
    found = [chunk for chunk in memory._chunks if chunk.ctypes.data == address]
    assert [chunk[0] for chunk in found] == [42.0]


@pytest.mark.parametrize("count", [1, 7, 8, 9, 513, 1025])
@pytest.mark.parametrize("width", [1, 4, 8])
@pytest.mark.parametrize("threads", [1, 2, 3, 16])
def test_shares_are_whole_blocks_and_cover_all_samples_once(count: int, width: int, threads: int) -> None:
    found = shares(count, width, threads)
    assert len(found) == threads
    assert [i for first, last in found for i in range(first, last)] == list(range(count))
    assert all(first % width == 0 for first, last in found if first < last)
    blocks = [-(-(last - first) // width) for first, last in found]
    assert max(blocks) - min(blocks) <= 1 or threads > -(-count // width)
