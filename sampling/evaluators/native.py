"""Functions as SIMD C over samples, on threads."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import SOLVER_FLAGS, aligned_zeros, build, generate, load, run_in_parallel, shares

from .batch_function import PER_SAMPLE, BatchFunction

Array = NDArray[np.float64]

_TEMPLATES = {name: files(__package__).joinpath("template", name).read_text(encoding="utf-8") for name in (
    "run.h", "run.c"
)}  # fmt: skip
_DOUBLE = 8  # bytes
_SHARE = 64  # least number of blocks of samples per thread: about ten microseconds of work
_KEPT = 8  # number of sizes (samples, steps) whose results are kept


class _Input(ct.Structure):
    _fields_ = (
        ("data", ct.c_void_p), ("sample", ct.c_long), ("step", ct.c_long), ("size", ct.c_int), ("shared", ct.c_int),
    )  # fmt: skip


class _Output(ct.Structure):
    _fields_ = (
        ("data", ct.c_void_p), ("row", ct.c_long), ("step", ct.c_long), ("sample", ct.c_long), ("size", ct.c_int),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Library:
    """A compiled library of functions.

    Args:
        loaded: the library.
        width: samples per instruction.
        work: size of the work array per sample, by function [doubles].
    """

    loaded: ct.CDLL
    width: int
    work: Mapping[str, int]


@lru_cache(maxsize=64)
def library_of(functions: tuple[tuple[str, cs.Function], ...], label: str = "sampling") -> Library:
    """Return the library of named functions, which is built, or found in the cache, once per process.

    Args:
        functions: C name and function of each.
        label: description for the list of the cache.

    Raises:
        NoCompilerError: no compiler works on this machine.
        CompileError: the compiler reports an error in a source.
    """
    units = generate(dict(functions))
    runner = ("run", _TEMPLATES["run.c"])
    built = build(
        [*((unit.name, unit.text) for unit in units.units), runner],
        headers={**units.headers, "run.h": _TEMPLATES["run.h"]},
        flags_per_unit={"run": SOLVER_FLAGS},
        label=label,
    )
    return Library(load(built), built.width, units.work)


class NativeFunction(BatchFunction):
    """A function of a compiled library.

    Args:
        library: the library.
        name: name of the function in the library.
        function: the function.
        by_row: see :class:`BatchFunction`.
        threads: number of threads that the samples are divided among.
    """

    def __init__(self, library: Library, name: str, function: cs.Function, *, by_row: bool, threads: int) -> None:
        super().__init__(function, by_row=by_row)
        self._width, self._threads = library.width, threads
        self._run = library.loaded.run
        self._run.restype = None
        self._address = ct.cast(getattr(library.loaded, name), ct.c_void_p)
        numbers = sum(size for _, size in self.inputs) + sum(self.sizes) + library.work[name]
        self._memory = [aligned_zeros(numbers * library.width) for _ in range(threads)]
        self._in = (_Input * max(len(self.inputs), 1))()
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None
        self._results: dict[tuple[int, int], tuple[list[Array], ct.Array[_Output]]] = {}

    def __call__(self, arguments: Sequence[Array], n: int, steps: int) -> list[Array]:
        """Return the outputs."""
        results, out = self._results_for(n, steps)
        kept = []
        for each, (name, size), argument in zip(self._in, self.inputs, arguments, strict=True):
            if argument.strides[-1] != _DOUBLE or any(stride % _DOUBLE for stride in argument.strides):
                argument = np.ascontiguousarray(argument)
                kept.append(argument)
            each.data, each.size, each.shared = argument.ctypes.data, size, name not in PER_SAMPLE
            each.sample, each.step = (0, *argument.strides[:-1])[-2:]
            each.sample, each.step = each.sample // _DOUBLE, each.step // _DOUBLE

        def run(part: tuple[int, int, int]) -> None:
            thread, first, last = part
            self._run(
                self._address, ct.c_int(len(self.inputs)), self._in, ct.c_int(len(self.sizes)), out,
                ct.c_long(steps), ct.c_long(first), ct.c_long(last), ct.c_void_p(self._memory[thread].ctypes.data),
            )  # fmt: skip

        parts = self._parts(n, steps)
        if self._pool is None:
            run(parts[0])
        else:
            run_in_parallel(run, parts, self._pool)
        return results

    def _parts(self, n: int, steps: int) -> list[tuple[int, int, int]]:
        """Return (thread, first, last) of the samples of each thread: whole blocks, except for the last block."""
        blocks = -(-n // self._width)
        threads = max(1, min(self._threads, blocks, blocks * steps // _SHARE))
        return [(i, first, last) for i, (first, last) in enumerate(shares(n, self._width, threads))]

    def _results_for(self, n: int, steps: int) -> tuple[list[Array], ct.Array[_Output]]:
        if (n, steps) not in self._results:
            if len(self._results) == _KEPT:
                self._results.pop(next(iter(self._results)))
            results, out = [], (_Output * len(self.sizes))()
            for each, size in zip(out, self.sizes, strict=True):
                if self.by_row:
                    memory = aligned_zeros(size * steps * n).reshape(size, steps, n)
                    results.append(memory.transpose(0, 2, 1))
                    each.row, each.step, each.sample = steps * n, n, 1
                else:
                    memory = aligned_zeros(n * steps * size).reshape(n, steps, size)
                    results.append(memory)
                    each.row, each.step, each.sample = 1, size, steps * size
                each.data, each.size = memory.ctypes.data, size
            self._results[n, steps] = results, out
        return self._results[n, steps]
