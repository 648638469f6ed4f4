"""The initial state: one check for problems, compiled problems and batches."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ProblemError, ShapeError

from .model import ModelBase
from .user_input import numbers_of

_OFF_UNIT = 0.1  # measured quaternions, and those of another precision, are nearer to unit length


def initial_state(model: ModelBase, initial: ArrayLike, where: str) -> NDArray[np.float64]:
    """Return an initial state of a model, (nx,), with its quaternions scaled to unit length.

    Args:
        model: the first model of the horizon.
        initial: the initial state, (nx,).
        where: the declaration or the call, for messages.

    Raises:
        ShapeError: the initial state has another size.
        ProblemError: it is not an array of numbers, it is not finite, or a quaternion is far from unit length.
    """
    state = model.state
    x = numbers_of(initial, where, "initial state")
    if x.shape != (state.nx,):
        layout = ", ".join(f"{block.quantity.path} {block.nx}" for block in state.blocks)
        raise ShapeError(
            f"{where}: initial state has the wrong size for model '{model.name}' - got shape {x.shape}, expected "
            f"({state.nx},): {layout}; build it with the model's state()"
        )
    bad = np.flatnonzero(~np.isfinite(x))
    if bad.size:
        entry = int(bad[0])
        raise ProblemError(
            f"{where}: initial state is not finite - got {x[entry]} at entry {entry}, '{state.stored_labels[entry]}' "
            f"of model '{model.name}', expected finite numbers; fix it"
        )
    for quantity, part in state.slices.items():
        if quantity.kind == "rotation" and not np.any(x[part]):
            raise ProblemError(
                f"{where}: initial state has an invalid '{quantity}' - got a quaternion of zeros, expected one of unit "
                "length, (1, 0, 0, 0) for no rotation; build it with the model's state()"
            )
        if quantity.kind == "rotation" and abs(float(np.linalg.norm(x[part])) - 1) > _OFF_UNIT:
            raise ProblemError(
                f"{where}: initial state has an invalid '{quantity}' - got a quaternion of length "
                f"{np.linalg.norm(x[part]):.3g}, {x[part].tolist()}, expected one of unit length; build it with the "
                "model's state()"
            )
    return state.np_normalise(x)
