"""What MuJoCo's loop wrote, taken over as states; in C where a compiler works, else in NumPy."""

from __future__ import annotations

import ctypes as ct
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import c_library, pointer

from .engine import MAX_SPEED, Array, may_be_bad


def take(simulated: Array, every: int, nq: int, due: float, states: Array) -> NDArray[np.bool_]:
    """Copy every n-th state that was simulated, and return the samples to look at, (n,): all bad ones, perhaps others.

    Args:
        simulated: (time, x) after each step of the simulator, (n, S · every, 1 + nx), contiguous.
        every: steps of the simulator per state.
        nq: number of positions in x; what follows are speeds.
        due: a time that every sample passes unless it was stopped [s].
        states: where to, (n, S, nx); each sample's contiguous.
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
    """Return a C function that MuJoCo may ask for the time at no cost, always zero; None without a compiler."""
    library = _library()
    return None if library is None else ct.CFUNCTYPE(ct.c_double)(("piaffe_no_time", library))
