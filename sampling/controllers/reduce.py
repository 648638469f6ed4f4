"""Reductions of violations (nc, n, S): the largest of each row, and the discount of each sample and step.

The code is in C if a compiler works, else in NumPy. Both use the memory layout of an evaluator: in each row, steps are
the outer axis and samples the inner one. JAX reduces its own arrays, also within ``jit``.
"""

from __future__ import annotations

import ctypes as ct
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.codegen import c_library, pointer
from piaffe.errors import ShapeError

from ..namespace import namespace

Array = NDArray[np.float64]

_DOUBLE = 8  # bytes
_TINY = 1e-300  # replaces a maximum of zero: then any violation gets the full discount, and zero gets none


def maxima(violation: Any, failed: Any = None) -> Any:
    """Return the largest violation of each row, (nc,).

    Args:
        violation: violations from an evaluator, (nc, n, S), at least 0; NaN counts as 0.
        failed: samples to leave out, (n,); none by default.

    Raises:
        ShapeError: the violations do not have three axes.
    """
    xp = namespace(violation)
    if xp is not np:
        found = violation if failed is None else xp.where(failed[:, None], 0.0, violation)
        return xp.nanmax(found, axis=(1, 2), initial=0.0)
    c = _with_contiguous_samples(violation if failed is None or not failed.any() else violation[:, ~failed])
    largest = np.zeros(len(c))
    if not c.size:
        return largest
    library = _library()
    if library is None:
        return np.asarray(np.fmax.reduce(c, axis=(1, 2), initial=0.0))
    library.piaffe_maxima(*_pointer_and_strides(c), pointer(largest))
    return largest


def discount(violation: Any, c_max: Any, p_max: ArrayLike, out: Array | None = None) -> Any:
    """Return δ = max_i p_i clip(c_i / c_i^max, 0, 1) of each sample and step, (n, S).

    If c_i^max is zero, any positive violation gets the full discount p_i.

    Args:
        violation: c from an evaluator, (nc, n, S).
        c_max: c^max of each row, (nc,).
        p_max: p of each row (nc,), of each row and step (nc, S), or one number for all.
        out: memory for the result, (S, n); new memory by default, and always with JAX.

    Raises:
        ShapeError: an array has the wrong shape.
    """
    if namespace(violation) is not np:
        return _discount_on_device(violation, c_max, np.asarray(p_max, dtype=float))
    c = _with_contiguous_samples(violation)
    rows, steps, n = c.shape
    largest, share = np.asarray(c_max, dtype=float), np.asarray(p_max, dtype=float)
    _check("c_max", largest.shape, ((rows,),))
    _check("p_max", share.shape, ((), (rows,), (rows, steps)))
    share = np.ascontiguousarray(np.broadcast_to(share[:, None] if share.ndim == 1 else share, (rows, steps)))
    slope = share / np.maximum(largest, _TINY)[:, None]
    delta = np.empty((steps, n)) if out is None else out
    _check("out", delta.shape, ((steps, n),))
    library = _library()
    if library is None:
        delta[:] = 0.0
        for row, by, top in zip(c, slope, share, strict=True):
            np.fmax(delta, np.fmin(row * by[:, None], top[:, None]), out=delta)
    elif c.size:
        library.piaffe_discount(*_pointer_and_strides(c), pointer(slope), pointer(share), pointer(delta))
    else:
        delta[:] = 0.0
    return delta.T


def _discount_on_device(violation: Any, c_max: Any, p_max: Array) -> Any:
    """Return δ (n, S) of arrays of JAX, in their precision."""
    xp = namespace(violation)
    share = xp.asarray(p_max[:, None] if p_max.ndim == 1 else p_max, violation.dtype)
    rows, _, steps = violation.shape
    share = xp.broadcast_to(share, (rows, steps))[:, None]
    slope = share / xp.maximum(c_max, xp.finfo(violation.dtype).tiny)[:, None, None]
    return xp.max(xp.fmin(violation * slope, share), axis=0, initial=0.0)


def _with_contiguous_samples(violation: Array) -> Array:
    """Return violations as (nc, S, n) with contiguous samples; a copy if they are not contiguous."""
    if violation.ndim != 3:
        raise ShapeError(
            f"violation does not fit - got {violation.shape}, expected (nc, n, S); pass what an evaluator returns"
        )
    c = violation.transpose(0, 2, 1)
    if c.strides[-1] != _DOUBLE or c.dtype != np.float64:
        c = np.ascontiguousarray(c, dtype=float)
    return c


def _check(name: str, got: tuple[int, ...], expected: tuple[tuple[int, ...], ...]) -> None:
    if got not in expected:
        shapes = " or ".join(map(str, expected))
        raise ShapeError(f"discount: {name} does not fit - got {got}, expected {shapes}; give one entry per row")


def _pointer_and_strides(c: Array) -> tuple[Any, ...]:
    rows, steps, n = c.shape
    numbers = (rows, c.strides[0] // _DOUBLE, steps, c.strides[1] // _DOUBLE, n)
    return (pointer(c), *map(ct.c_long, numbers))


@lru_cache(maxsize=1)
def _library() -> ct.CDLL | None:
    loaded = c_library("piaffe.sampling.controllers", "reduce", "reductions of violations")
    if loaded is not None:
        loaded.piaffe_maxima.restype = loaded.piaffe_discount.restype = None
    return loaded
