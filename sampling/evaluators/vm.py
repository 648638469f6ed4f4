"""Functions in CasADi's virtual machine: slow, but without a compiler; the reference for the other engines."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from .batch_function import PER_SAMPLE, BatchFunction

Array = NDArray[np.float64]

_SHARE = 1024  # samples at a time: the time to map a function increases with their number


class VmFunction(BatchFunction):
    """A function that is mapped over the samples of a step."""

    def __call__(self, arguments: Sequence[Array], n: int, steps: int) -> list[Array]:
        """Return the outputs."""
        results = [np.zeros((size, steps, n)) for size in self.sizes]
        for first in range(0, n, _SHARE):
            self._part(arguments, slice(first, min(n, first + _SHARE)), steps, results)
        order = (0, 2, 1) if self.by_row else (2, 1, 0)
        return [result.transpose(order) for result in results]

    def _part(self, arguments: Sequence[Array], part: slice, steps: int, results: list[Array]) -> None:
        """Write the outputs of a range of samples."""
        n = part.stop - part.start
        buffer, run = _mapped(self.function, n)
        flat = [np.zeros(max(1, n * size)) for size in self.sizes]
        for i, each in enumerate(flat):
            buffer.set_res(i, each.data)
        for step in range(steps):
            held = []
            for i, ((name, size), argument) in enumerate(zip(self.inputs, arguments, strict=True)):
                values = argument[part, step] if name in PER_SAMPLE else argument[step]
                held.append(np.ascontiguousarray(values).reshape(-1) if size else np.zeros(1))
                buffer.set_arg(i, held[-1].data)
            run()
            for result, each, size in zip(results, flat, self.sizes, strict=True):
                result[:, step, part] = each[: n * size].reshape(n, size).T


@lru_cache(maxsize=256)
def _mapped(function: cs.Function, n: int) -> tuple[Any, Any]:
    shared = [i for i, name in enumerate(function.name_in()) if name not in PER_SAMPLE]
    mapped = function.map(f"{function.name()}_{n}", "serial", n, shared, []) if n > 1 else function
    buffer, run = mapped.buffer()
    return buffer, run
