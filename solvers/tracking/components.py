"""Components of a state: those that are left out, and those that the controls drive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError, UnknownNameError
from piaffe.ocp import Block, LoweredMode, Manifold

Array = NDArray[np.float64]


def kept(space: Manifold, leave_out: Sequence[str], where: str) -> Array:
    """Return 0 for the components of the tangent that are left out, 1 for the others (ndx,)."""
    names = [label.strip() for label in space.labels]
    flags = np.ones(space.ndx)
    for name in leave_out:
        own = [i for i, label in enumerate(names) if label == name or label.startswith(f"{name} ")]
        if not own:
            raise UnknownNameError(where, "component of the state", name, names)
        flags[own] = 0.0
    return flags


def rates(mode: LoweredMode) -> Block | None:
    """Return the state's block of velocities with the labels of the controls; None if there is none."""
    labels = tuple(label for block in mode.model.control.blocks for label in block.labels)
    return next((each for each in mode.state.blocks if each.rate_of is not None and each.labels == labels), None)


class Driven(NamedTuple):
    """The slices, in the tangent of the state, of the positions and velocities that the controls drive."""

    position: slice
    velocity: slice


def driven(mode: LoweredMode) -> Driven:
    """Return the positions and velocities with the labels of the controls.

    Raises:
        SolverError: the state has no such velocities.
    """
    block, slices = rates(mode), mode.state.tangent_slices
    if block is not None and block.rate_of is not None:
        return Driven(slices[block.rate_of], slices[block.quantity])
    names = ", ".join(label.strip() for label in mode.model.control.labels)
    raise SolverError(
        f"joint gains, model '{mode.model.name}': the state has no velocities of the controls - got controls {names}, "
        "expected a block of the state with these labels that is the rate of another; leave the gains out"
    )


def damped(mode: LoweredMode, x: Array, damping: float) -> Array:
    """Return −damping v of the joints; zero for speeds that are not finite or that the state does not have.

    Args:
        mode: the mode.
        x: state (nx,).
        damping: [Nm s/rad].
    """
    block = rates(mode)
    if block is None:
        return np.zeros(mode.nu)
    speed = x[mode.state.slices[block.quantity]]
    return np.asarray(-damping * np.where(np.isfinite(speed), speed, 0.0))
