"""A MuJoCo model as MJX takes it, or a sentence on what it does not take."""

from __future__ import annotations

import contextlib
import io
import warnings
from typing import Any

from piaffe.errors import SamplingError
from piaffe.models import import_mujoco


class MjxWarning(UserWarning):
    """MJX simulates something else than MuJoCo would."""


def import_mjx() -> Any:
    """Return the module ``mujoco.mjx``.

    Raises:
        SamplingError: it is not installed.
    """
    try:
        # it reports on optional packages by printing
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            from mujoco import mjx
    except ImportError as error:
        raise SamplingError(
            f"mjx engine: MJX cannot be imported - got {error}, expected the packages of sampling on JAX; "
            "pip install 'piaffe[sampling]', or choose engine=\"native\""
        ) from error
    return mjx


def on_device(model: Any, device: Any = None) -> tuple[Any, Any]:
    """Return the model and its blank data as MJX has them, in the precision that JAX has enabled.

    Args:
        model: a ``mujoco.MjModel``; its options may be changed.
        device: a device of JAX; its default one unless given.

    Raises:
        SamplingError: MJX lacks what the model needs.
    """
    mjx = import_mjx()
    _settle_options(model)
    try:
        return mjx.put_model(model, device=device, impl="jax"), mjx.make_data(model, device=device, impl="jax")
    except NotImplementedError as error:
        raise SamplingError(
            f"mjx engine: MJX has not all that the model needs - got '{error}', expected shapes and actuators that it "
            'has; let other shapes collide (spheres on planes, boxes and height fields do), or choose engine="native"'
        ) from error


def _settle_options(model: Any) -> None:
    """Replace PGS by Newton; refuse what has no counterpart."""
    mujoco = import_mujoco()
    solvers, integrators = mujoco.mjtSolver, mujoco.mjtIntegrator
    if model.opt.solver == solvers.mjSOL_PGS:
        warnings.warn(
            f"mjx engine: MJX has no PGS solver, Newton takes its place with {model.opt.iterations} iterations; ask "
            "for Newton in the model's contact to have the same solver on every engine",
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
