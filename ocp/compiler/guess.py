"""The initial guess: states along the path; controls of the path, else of the model, else zero."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError

from ..language import TIME_STEP, ModelBase, Node, Quantity, Sample
from .layout import Layout

Array = NDArray[np.float64]


def guess_states(model: ModelBase, samples: Sequence[Sample], start: Sample) -> Array:
    """Return the states at samples of the path, (N, nx); blocks without targets keep their initial value, else zero.

    Args:
        model: the model.
        samples: the path at the nodes.
        start: the parts of the initial state.
    """
    rows: dict[Quantity, Array] = {}
    for block in model.state.blocks:
        initial = start.get(block.quantity)
        if initial is None:
            initial = np.eye(4)[0] if block.quantity.kind == "rotation" else np.zeros(block.nx)
        rows[block.quantity] = np.array([sample.get(block.quantity, initial) for sample in samples], dtype=float)
    return model.state.np_normalise(model.state.pack(rows))


def guess_controls(model: ModelBase, nodes: Sequence[Node], states: Array, layout: Layout, p: Array) -> Array:
    """Return the controls at the stages of a phase, (N, nu): from the path, else from the model's guess, else zero.

    Args:
        model: the model.
        nodes: the first nodes of the stages, (N).
        states: the guess of the states, (N+1, nx).
        layout: the positions of the model's slots in p.
        p: parameters of the stages, (N, np).

    Raises:
        ModelError: the model's guess has other quantities or shapes than its control.
    """
    blocks = model.control.blocks
    if not blocks:
        return np.zeros((len(nodes), 0))
    own: Mapping[Quantity, Array] = {}
    if not all(block.quantity in node.sample for block in blocks for node in nodes):
        own = _checked(model, len(nodes), model.control_guess(nodes, states, _slots(model, layout, p)))
    rows: dict[Quantity, Array] = {}
    for block in blocks:
        rows[block.quantity] = table = np.zeros((len(nodes), block.nx))
        table[:] = own.get(block.quantity, 0.0)
        for k, node in enumerate(nodes):
            if block.quantity in node.sample:
                table[k] = node.sample[block.quantity]
    return model.control.pack(rows)


def _slots(model: ModelBase, layout: Layout, p: Array) -> dict[str, Array]:
    """Return the values of the model's slots and ``"dt"``, (N, size) each."""
    values = {slot.name: np.tile(slot.default, (len(p), 1)) for slot in model.slots if slot.name not in layout.slots}
    values |= {name: p[:, part] for name, part in layout.slots.items()}
    return {**values, "dt": p[:, layout.slices[TIME_STEP]]}


def _checked(model: ModelBase, n: int, guess: Mapping[Quantity, Array]) -> dict[Quantity, Array]:
    """Return a model's guess as arrays; raise ModelError if it does not fit the control at n stages."""
    sizes, where = {b.quantity: b.nx for b in model.control.blocks}, f"model '{model.name}', control_guess"
    checked: dict[Quantity, Array] = {}
    for quantity, value in guess.items():
        if quantity not in sizes:
            raise ModelError(
                f"{where}: contains what is no control - got '{quantity}', expected blocks of the control "
                f"({', '.join(map(str, sizes))}); return these alone"
            )
        checked[quantity] = np.asarray(value, dtype=float)
        if checked[quantity].shape != (n, sizes[quantity]):
            raise ModelError(
                f"{where}, '{quantity}': wrong shape - got {checked[quantity].shape}, expected "
                f"{(n, sizes[quantity])}; return one row per stage"
            )
    return checked
