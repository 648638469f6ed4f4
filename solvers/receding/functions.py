"""The functions of a receding horizon that are generated as C, by their names in the library."""

from __future__ import annotations

import casadi as cs

from piaffe.ocp import Horizon, LoweredMode, LoweredTransition, Manifold, ModelBase, moved_symbols, rotation


def generated_functions(horizon: Horizon) -> dict[str, cs.Function]:
    """Return name → function: weights of modes and transitions, references, motions of states, controls and samples."""
    found: dict[str, cs.Function] = {}
    for i, store in enumerate(horizon.tables.modes):
        found[f"mode{i}_weights"] = store.lowered.functions["stage_w"]
        found[f"mode{i}_end_weights"] = store.lowered.functions["terminal_w"]
        if isinstance(store.lowered, LoweredMode) and store.lowered in horizon.falls.functions:
            found[f"mode{i}_fall"] = horizon.falls.functions[store.lowered]
    for i, store in enumerate(horizon.tables.transitions):
        assert isinstance(store.lowered, LoweredTransition)
        found[f"transition{i}_weights"] = store.lowered.functions["rows_w"]
    pieces = horizon.courses.pieces
    for i, piece in enumerate(pieces):
        of = piece.functions
        if of is None:
            continue
        for name in ("start", "begin", "advance", "move", "sample", "pose"):
            found[f"piece{i}_{name}"] = getattr(of, name)
        before = pieces[i - 1].functions if i else None
        if before is not None:
            found[f"piece{i}_pick"] = of.pick(before.quantities)
    if horizon.courses.placed is not None:
        found["placed"] = horizon.courses.placed
    head = horizon.models[0]
    if head.planar_pose is None:
        return found
    for i, model in enumerate(spaces(horizon)):
        found[f"space{i}_state"] = _moved(model.state)
        if any(block.quantity.kind != "vector" for block in model.control.blocks):
            found[f"space{i}_control"] = _moved(model.control)
    targets = horizon.targets
    s, motion = cs.SX.sym("s", targets.size), cs.SX.sym("motion", 3)
    parts = [(q, s[part]) for q, part in zip(targets.quantities, targets.slices.values(), strict=True)]
    found["moved_sample"] = _function("moved_sample", [s, motion], moved_symbols(parts, motion))
    x = cs.SX.sym("x", head.state.nx)
    position, orientation = (x[head.state.slices[quantity]] for quantity in head.planar_pose)
    found["pose"] = _function("pose", [x], [position[0], position[1], rotation.to_rpy(orientation)[2]])
    return found


def spaces(horizon: Horizon) -> tuple[ModelBase, ...]:
    """Return the models of a horizon, each once; each has its state space."""
    return tuple(dict.fromkeys(horizon.models))


def _moved(space: Manifold) -> cs.Function:
    x, motion = cs.SX.sym("x", space.nx), cs.SX.sym("motion", 3)
    return _function("moved", [x, motion], moved_symbols([(q, x[part]) for q, part in space.slices.items()], motion))


def _function(name: str, inputs: list[cs.SX], outputs: list[cs.SX]) -> cs.Function:
    return cs.Function(name, inputs, [cs.densify(cs.vertcat(*outputs))], {"cse": True})
