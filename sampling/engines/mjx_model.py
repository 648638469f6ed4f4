"""Conversion of a MuJoCo model for MJX, with errors for what MJX does not support."""

from __future__ import annotations

import contextlib
import io
import warnings
from typing import Any

from piaffe.errors import SamplingError
from piaffe.models import import_mujoco


class MjxWarning(UserWarning):
    """MJX simulates the model in another way than MuJoCo."""


def import_mjx() -> Any:
    """Return the module ``mujoco.mjx``.

    Raises:
        SamplingError: it is not installed.
    """
    try:
        # the import prints messages about optional packages
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            from mujoco import mjx
    except ImportError as error:
        raise SamplingError(
            f"mjx engine: MJX cannot be imported - got {error}, expected the packages of sampling on JAX; "
            "pip install 'piaffe[sampling]', or choose engine=\"native\""
        ) from error
    return mjx


def on_device(model: Any, device: Any = None) -> tuple[Any, Any]:
    """Return the model and its initial data for MJX, in the precision that JAX has enabled.

    Args:
        model: a ``mujoco.MjModel``; its options may be changed.
        device: a device of JAX; by default its default device.

    Raises:
        SamplingError: MJX does not support the model.
    """
    mjx = import_mjx()
    _adapt_options(model)
    try:
        return mjx.put_model(model, device=device, impl="jax"), mjx.make_data(model, device=device, impl="jax")
    except NotImplementedError as error:
        raise SamplingError(
            f"mjx engine: MJX does not support the model - got '{error}', expected shapes and actuators of MJX; "
            'use other shapes for collisions (spheres on planes, boxes or height fields), or choose engine="native"'
        ) from error


def _adapt_options(model: Any) -> None:
    """Replace PGS by Newton; raise an error for options that MJX lacks."""
    mujoco = import_mujoco()
    solvers, integrators = mujoco.mjtSolver, mujoco.mjtIntegrator
    if model.opt.solver == solvers.mjSOL_PGS:
        warnings.warn(
            f"mjx engine: MJX has no PGS solver, Newton takes its place with {model.opt.iterations} iterations; "
            "choose Newton in the model's contact to have the same solver on every engine",
            MjxWarning,
            stacklevel=4,
        )
        model.opt.solver = solvers.mjSOL_NEWTON
    known = {
        int(integrators.mjINT_EULER): "Euler",
        int(integrators.mjINT_RK4): "RK4",
        int(integrators.mjINT_IMPLICITFAST): "implicitfast",
    }
    if int(model.opt.integrator) not in known:
        name = integrators(model.opt.integrator).name.removeprefix("mjINT_").lower()
        raise SamplingError(
            f"mjx engine: option integrator - got '{name}', expected one that MJX has: {', '.join(known.values())}; "
            'change it in the model\'s contact, or choose engine="native"'
        )
    if model.opt.noslip_iterations:
        raise SamplingError(
            f"mjx engine: option noslip_iterations - got {model.opt.noslip_iterations}, expected 0, MJX has none; set "
            'it to 0, or choose engine="native"'
        )
