"""Rollouts by MuJoCo XLA: every sample at once, on whatever processor JAX has."""

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

    The first rollout of a size compiles for it, which takes half a minute; ``jax_compilation_cache_dir`` keeps what
    was compiled. MuJoCo's PGS solver, which MJX has not, is replaced by Newton, with a warning.

    Args:
        model: what to simulate. A sample's control is held over the model's substeps.
        precision: ``"single"``, what GPUs are good at, or ``"double"``.
        warm_start: whether the contact solver starts from the last step's solution, as the model has it unless given.
        device: a device of JAX; its default one unless given.

    Raises:
        SamplingError: JAX or MJX is not installed, or MJX has not what the model needs.
        ModelError: the simulated state is more than positions and speeds.
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

        Products of matrices have all digits of their type: by default GPUs round factors to the eleven bits of TF32.
        """
        jax = self._jax
        double = enable_x64(jax, self.precision == "double")
        with double, jax.default_device(self.device), jax.default_matmul_precision("highest"):
            yield

    def states(self, x0: Any, controls: Any) -> tuple[Any, Any]:
        """Return states (S + 1, nx) and whether the sample failed, of one sample, for use within ``jit`` and ``vmap``.

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
    """Return the function of a simulation's data and a control that gives its data after the substeps."""
    mjx = import_mjx()

    def advance(data: Any, control: Any) -> Any:
        data = data.replace(ctrl=control)
        if substeps == 1:
            return mjx.step(model, data)
        return jax.lax.fori_loop(0, substeps, lambda _, data: mjx.step(model, data), data)

    return advance


def enable_x64(jax: Any, enabled: bool) -> Any:
    """Return the context in which JAX has, or has not, double precision."""
    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(enabled)
    older = importlib.import_module("jax.experimental")
    return older.enable_x64(enabled)
