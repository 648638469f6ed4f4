"""The package ``mujoco``, imported on first use."""

from __future__ import annotations

from typing import Any

from piaffe.errors import ModelError


def import_mujoco() -> Any:
    """Return the package.

    Raises:
        ModelError: it is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise ModelError(
            "mujoco scene: MuJoCo is not installed - got no package 'mujoco', expected it; pip install mujoco"
        ) from error
    return mujoco
