"""Sizes, orders and limits of a controller, for its header and its README."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SolverError
from piaffe.ocp import Constraint, Horizon, LoweredMode

from ..receding import Motions, Plan, RecedingHorizon
from ..tracking import LowLevel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Layout:
    """What a caller of a controller has to know of its numbers.

    Args:
        state: name and unit of each entry of a state.
        control: names of the controls.
        positions: place of the joints' angles in the state.
        speeds: place of the joints' speeds in the state.
        recorded: per quantity that the model records, its path, unit and the names of its components.
        lower: of the controls.
        upper: of the controls.
        commands: names of the commands, and their declared values.
        places: per command, its places among the commands of all pieces and motions.
        motions: names of several motions; empty for one.
    """

    state: tuple[tuple[str, str], ...]
    control: tuple[str, ...]
    positions: int
    speeds: int
    recorded: tuple[tuple[str, str, tuple[str, ...]], ...]
    lower: Array
    upper: Array
    commands: dict[str, float]
    places: dict[str, tuple[int, ...]]
    motions: tuple[str, ...] = ()


def layout_of(mpc: RecedingHorizon | Motions, low: LowLevel, plan: Plan) -> Layout:
    """Return the layout of a controller.

    Args:
        mpc: the planner.
        low: the low level.
        plan: a plan of the planner; the limits of its first stage hold where there is no plan, the widest ones if
            they vary over phases.

    Raises:
        SolverError: the state has no speeds of the controls.
    """
    phase = plan.phases[0]
    mode: LoweredMode = phase.mode
    state = tuple(
        (f"{block.quantity.path} {label}", "" if block.quantity.kind == "rotation" else block.quantity.unit)
        for block in mode.state.blocks
        for label in (("w", *block.labels) if block.quantity.kind == "rotation" else block.labels)
    )
    labels = tuple(label for block in mode.model.control.blocks for label in block.labels)
    positions = speeds = -1
    for block in mode.state.blocks:
        if block.rate_of is not None and block.labels == labels:
            speeds = mode.state.slices[block.quantity].start
            positions = mode.state.slices[block.rate_of].start
    if speeds < 0:
        raise SolverError(
            f"export: there are no speeds to damp - got model '{mode.model.name}', whose state has no speeds of its "
            "controls, expected joints; export a problem whose first model has joints"
        )
    recorded = tuple(
        (quantity.path, quantity.unit, labels if len(labels) == size else tuple(map(str, range(size))))
        for (quantity, size), labels in zip(mode.outputs, mode.output_labels, strict=True)
    )
    motions = mpc.names if isinstance(mpc, Motions) else ()
    horizons = tuple(mpc.horizons.values()) if isinstance(mpc, Motions) else (mpc.horizon,)
    lower, upper = low.rows[mode].limits(phase.states[0], phase.p[0], phase.g_mask[0])
    for horizon in horizons:
        lower, upper = _widened(low, phase.states[0], (lower, upper), horizon)
    places: dict[str, list[int]] = {}
    declared: dict[str, float] = {}
    at = int(bool(motions))  # the motion that is asked for comes first
    for horizon in horizons:
        declared = {**horizon.commands, **declared}
        for piece in horizon.courses.pieces:
            for name in piece.functions.commands if piece.functions is not None else ():
                places.setdefault(name, []).append(at)
                at += 1
    return Layout(
        state, labels, positions, speeds, recorded, lower, upper, declared,
        {name: tuple(own) for name, own in places.items()}, motions,
    )  # fmt: skip


def _widened(low: LowLevel, x: Array, limits: tuple[Array, Array], horizon: Horizon) -> tuple[Array, Array]:
    """Return limits of the controls that also hold at the other times of a motion, lower and upper (nu,).

    Args:
        low: the low level.
        x: a state (nx,).
        limits: those of a first stage; a bound that varies over phases is different at other times.
        horizon: the motion.
    """
    terms = [term for term, _ in horizon.problem.scoped_terms() if isinstance(term, Constraint)]
    if not any(term.varies("lower") or term.varies("upper") for term in terms):
        return limits
    lower, upper = limits
    for store in horizon.tables.modes:
        rows = low.rows.get(store.lowered) if isinstance(store.lowered, LoweredMode) else None
        if rows is None:
            continue
        for p, g_mask in zip(store.rows, rows.masks(store.rows)[0], strict=True):
            found = rows.limits(x, p, g_mask)
            lower, upper = np.minimum(lower, found[0]), np.maximum(upper, found[1])
    return lower, upper
