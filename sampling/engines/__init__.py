"""Rollout engines: one interface, several simulators.

==========  ===================================================  ======================
engine      how                                                  needs
==========  ===================================================  ======================
``native``  MuJoCo in C, samples spread over threads             nothing
``mjx``     MuJoCo XLA: all samples at once on a CPU or a GPU    ``piaffe[sampling]``
==========  ===================================================  ======================
"""

from __future__ import annotations

from typing import Any, Literal, get_args

from piaffe.errors import SamplingError

from .engine import MAX_SPEED, Engine, Rollouts, Simulated
from .mjx import MjxEngine
from .native import NativeEngine

EngineName = Literal["native", "mjx"]

__all__ = [
    "MAX_SPEED",
    "Engine",
    "EngineName",
    "MjxEngine",
    "NativeEngine",
    "Rollouts",
    "Simulated",
    "engine_for",
]


def engine_for(model: Simulated, name: EngineName = "native", *, threads: int | None = None, **options: Any) -> Engine:
    """Return an engine for a model.

    Args:
        model: what to simulate, as ``models.Mujoco``.
        name: ``"native"`` or ``"mjx"``.
        threads: of the native engine; one per core by default. XLA has its own.
        **options: of :class:`NativeEngine` or :class:`MjxEngine`.

    Raises:
        SamplingError: there is no such engine, JAX is not installed, or MJX has not what the model needs.
        ModelError: the simulated state is more than positions and speeds.
    """
    if name == "native":
        return NativeEngine(model, threads=threads, **options)
    if name == "mjx":
        return MjxEngine(model, **options)
    known = " or ".join(f"'{known}'" for known in get_args(EngineName))
    raise SamplingError(f"rollouts: engine is unknown - got {name!r}, expected {known}; choose one")
