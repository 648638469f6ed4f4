"""Copies the results of MuJoCo's loop into arrays of states; in C if a compiler works, else in NumPy."""

from __future__ import annotations

import ctypes as ct
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import c_library, pointer

from .engine import MAX_SPEED, Array, may_be_bad


def take(simulated: Array, every: int, nq: int, due: float, states: Array) -> NDArray[np.bool_]:
    """Copy one in ``every`` simulated states; return the samples to check, (n,): all bad ones, and possibly others.

    Args:
        simulated: (time, x) after each step of the simulator, (n, S · every, 1 + nx), contiguous.
        every: steps of the simulator per state.
        nq: number of positions in x, which are before the velocities.
        due: a time that the last time of every sample exceeds, unless the simulator stopped [s].
        states: destination, (n, S, nx); contiguous for each sample.
    """
    library = _library()
    if library is None:
        states[:] = simulated[:, every - 1 :: every, 1:]
        return may_be_bad(states, nq) | ~(simulated[:, -1, 0] > due)
    n, steps, nx = states.shape
    suspect = np.empty(n, dtype=np.bool_)
    library.piaffe_take(
        pointer(simulated), *map(ct.c_long, (n, steps, every, nq, nx - nq)), ct.c_double(due),
        ct.c_double(MAX_SPEED), pointer(states), ct.c_long(states.strides[0] // states.itemsize),
        pointer(suspect),
    )  # fmt: skip
    return suspect


@lru_cache(maxsize=1)
def _library() -> ct.CDLL | None:
    loaded = c_library("piaffe.sampling.engines", "take", "states of rollouts")
    if loaded is not None:
        loaded.piaffe_take.restype = None
    return loaded


@lru_cache(maxsize=1)
def no_time() -> Any:
    """Return a C function that MuJoCo can call instead of its clock and that returns 0; None without a compiler."""
    library = _library()
    return None if library is None else ct.CFUNCTYPE(ct.c_double)(("piaffe_no_time", library))
