"""Functions on JAX arrays, compiled by XLA for a CPU or a GPU; they can be called within ``jit``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as cs

from ..translate import import_jax, instructions
from .batch_function import PER_SAMPLE, BatchFunction


class JaxFunction(BatchFunction):
    """The instructions of a function on JAX arrays, in the precision of its arguments.

    Raises:
        SamplingError: JAX is not installed.
    """

    def __init__(self, function: cs.Function, *, by_row: bool) -> None:
        super().__init__(function, by_row=by_row)
        jax = import_jax()
        self._jnp = jnp = jax.numpy
        program = instructions(function, jnp, jax.scipy.special.erf)
        names = [name for name, _ in self.inputs]
        axis = 0 if by_row else -1

        def evaluate(n: int, steps: int, arguments: tuple[Any, ...]) -> list[Any]:
            dtype = jnp.result_type(float, *arguments) if not arguments else jnp.result_type(*arguments)
            columns = [
                [argument[..., k] if name in PER_SAMPLE else argument[None, :, k] for k in range(argument.shape[-1])]
                for name, argument in zip(names, arguments, strict=True)
            ]
            return [
                jnp.stack([jnp.broadcast_to(jnp.asarray(row, dtype), (n, steps)) for row in rows], axis=axis)
                if rows
                else jnp.zeros((0, n, steps) if by_row else (n, steps, 0), dtype)
                for rows in program.columns(*columns)
            ]

        self._evaluate = jax.jit(evaluate, static_argnums=(0, 1))

    def array(self, value: Any) -> Any:  # type: ignore[override]
        """Return an array of JAX; a tracer is returned unchanged."""
        return self._jnp.asarray(value)

    def __call__(self, arguments: Sequence[Any], n: int, steps: int) -> list[Any]:
        """Return the outputs."""
        return list(self._evaluate(n, steps, tuple(arguments)))
