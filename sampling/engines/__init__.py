"""Rollout engines: one interface, several simulators.

==========  ===================================================================  ======================
engine      how                                                                  needs
==========  ===================================================================  ======================
``native``  MuJoCo in C, samples divided among threads                           nothing
``simd``    MuJoCo's step as generated C, with SIMD over samples, on threads     a C compiler
``mjx``     MuJoCo XLA: all samples at once on a CPU or a GPU                    ``piaffe[sampling]``
``auto``    ``simd`` if it supports the model, else ``native``                   nothing
==========  ===================================================================  ======================
"""

from __future__ import annotations

import warnings
from typing import Any, get_args

from piaffe.errors import SamplingError, renamed

from ..options import EngineName
from .engine import MAX_SPEED, Engine, Rollouts, Simulated
from .mjx import MjxEngine
from .native import NativeEngine
from .simd import DifferentError, SimdEngine

__all__ = [
    "MAX_SPEED",
    "DifferentError",
    "Engine",
    "EngineName",
    "MjxEngine",
    "NativeEngine",
    "Rollouts",
    "SimdEngine",
    "Simulated",
    "engine_for",
]


def engine_for(model: Simulated, name: EngineName = "auto", *, threads: int | None = None, **options: Any) -> Engine:
    """Return an engine for a model.

    Args:
        model: what to simulate, as ``models.Mujoco``.
        name: ``"auto"``, ``"native"``, ``"simd"`` or ``"mjx"``.
        threads: number of threads of the engines in C; one per core by default. XLA has its own threads.
        **options: options of the engine's class; with ``"auto"``, those that :class:`NativeEngine` and
            :class:`SimdEngine` both have.

    Raises:
        SamplingError: there is no such engine, it does not support the model, or a package or compiler is missing.
        ModelError: the simulated state is more than positions and velocities.
    """
    if name == "mjx":
        return MjxEngine(model, **options)
    if name == "simd":
        return SimdEngine(model, threads=threads, **options)
    if name == "auto":
        try:
            return SimdEngine(model, threads=threads, **options)
        except DifferentError as error:
            warnings.warn(f"rolling out with MuJoCo itself, five times slower: {error}", stacklevel=2)
        except SamplingError:
            pass  # the native engine simulates the model instead
    if name in ("auto", "native"):
        return NativeEngine(model, threads=threads, **options)
    if str(name) == "lanes":
        raise SamplingError("rollouts: engine was renamed - got 'lanes', expected 'simd', its name now; use that")
    known = ", ".join(f"'{known}'" for known in get_args(EngineName))
    raise SamplingError(f"rollouts: engine is unknown - got {name!r}, expected one of {known}; choose one")


__getattr__ = renamed(__name__, {"LanesEngine": "piaffe.sampling.engines.SimdEngine"})
