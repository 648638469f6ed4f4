"""Roll-outs by MuJoCo XLA: all samples at once, on any device of JAX."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np

from piaffe.errors import SamplingError
from piaffe.models import import_mujoco

from ..translate import import_jax
from .engine import MAX_SPEED, Array, Engine, Rollouts, Simulated
from .mjx_model import import_mjx, on_device
from .native import own_copy

Precision = Literal["single", "double"]


class MjxEngine(Engine):
    """Simulates all samples at once, by MuJoCo XLA under ``jit`` and ``vmap``.

    The first roll-out of each size compiles code for it, which takes half a minute. JAX keeps compiled code in the
    folder ``jax_compilation_cache_dir``, if that is set. MJX lacks MuJoCo's PGS solver; Newton replaces it, with a
    warning.

    Args:
        model: model to simulate. A sample's control is constant over the model's substeps.
        precision: ``"single"``, which is fast on GPUs, or ``"double"``.
        warm_start: whether the contact solver starts from the last step's solution; as in the model by default.
        device: a device of JAX; by default its default device.

    Raises:
        SamplingError: JAX or MJX is not installed, or MJX does not support the model.
        ModelError: the simulated state is more than positions and velocities.
    """

    name = "mjx"

    def __init__(
        self,
        model: Simulated,
        *,
        precision: Precision = "single",
        warm_start: bool | None = None,
        device: Any = None,
    ) -> None:
        if precision not in ("single", "double"):
            raise SamplingError(
                f"mjx engine: precision is unknown - got {precision!r}, expected 'single' or 'double'; choose one"
            )
        self._jax = import_jax()
        self.precision, self.substeps, self.device = precision, model.substeps, device
        compiled = own_copy(import_mujoco(), model.compiled(), warm_start=warm_start)
        super().__init__(compiled.nq, compiled.nv, compiled.nu)
        with self.computing():
            self._model, self._blank = on_device(compiled, device)
            self._roll = self._jax.jit(self._jax.vmap(self.states, (0, 0)))

    def _simulate(self, x0: Array, controls: Array) -> Rollouts:
        starts = np.broadcast_to(x0, (len(controls), x0.shape[-1]))
        with self.computing():
            jnp = self._jax.numpy
            states, failed = self._roll(jnp.asarray(starts, self.dtype), jnp.asarray(controls, self.dtype))
        return Rollouts(np.asarray(states, dtype=float), np.asarray(failed))

    @property
    def dtype(self) -> Any:
        """The type of numbers on the device."""
        return np.float32 if self.precision == "single" else np.float64

    @contextmanager
    def computing(self) -> Iterator[None]:
        """Compute in this engine's precision and on its device: a context for calls of :meth:`states` under ``jit``.

        Matrix products have the full precision of their type; by default, GPUs round the factors to the 11 bits of
        TF32.
        """
        jax = self._jax
        double = enable_x64(jax, self.precision == "double")
        with double, jax.default_device(self.device), jax.default_matmul_precision("highest"):
            yield

    def states(self, x0: Any, controls: Any) -> tuple[Any, Any]:
        """Return the states (S + 1, nx) of one sample and whether it failed, for use within ``jit`` and ``vmap``.

        Args:
            x0: (nx,).
            controls: (S, nu).
        """
        jnp, nq = self._jax.numpy, self.nq
        advance = _stepping(self._jax, self._model, self.substeps)

        def bad(x: Any) -> Any:
            return ~(jnp.isfinite(x).all() & (jnp.abs(x[nq:]) <= MAX_SPEED).all())

        def step(carry: tuple[Any, Any, Any], control: Any) -> tuple[tuple[Any, Any, Any], Any]:
            data, last, failed = carry
            data = advance(data, control)
            x = jnp.concatenate([data.qpos, data.qvel])
            failed = failed | bad(x) | ~jnp.isfinite(control).all()
            x = jnp.where(failed, last, x)
            return (data, x, failed), x

        failed = bad(x0)
        start = jnp.where(jnp.isfinite(x0), x0, 0.0)
        data = self._blank.replace(qpos=x0[:nq], qvel=x0[nq:])
        (_, _, failed), path = self._jax.lax.scan(step, (data, start, failed), controls)
        return jnp.concatenate([start[None], path]), failed

    def _release(self) -> None:
        self._roll = self._model = self._blank = None


def _stepping(jax: Any, model: Any, substeps: int) -> Callable[[Any, Any], Any]:
    """Return a function of a simulation's data and a control that returns the data after the substeps."""
    mjx = import_mjx()

    def advance(data: Any, control: Any) -> Any:
        data = data.replace(ctrl=control)
        if substeps == 1:
            return mjx.step(model, data)
        return jax.lax.fori_loop(0, substeps, lambda _, data: mjx.step(model, data), data)

    return advance


def enable_x64(jax: Any, enabled: bool) -> Any:
    """Return the context that enables or disables double precision in JAX."""
    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(enabled)
    older = importlib.import_module("jax.experimental")
    return older.enable_x64(enabled)
