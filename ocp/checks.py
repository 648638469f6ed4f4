"""Checks of a compiled problem before any solve: targets, controls without cost, NaN at the initial guess."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError, UnknownNameError

from .batch import Batch
from .compiled import CompiledPhase, CompiledProblem
from .lowering import Row
from .model import ModelBase
from .motion import Motion
from .path import Path

Array = NDArray[np.float64]


def check_targets(motion: Motion, path: Path, models: list[ModelBase]) -> None:
    """Raise if a keyframe speaks of something that no model has."""
    for piece in motion.pieces:
        for phase in piece.phases:
            if phase.target is None:
                continue
            for name, value in phase.target.values.items():
                errors = []
                for model in models:
                    try:
                        model.keyframe({name: value})
                        break
                    except UnknownNameError as error:
                        errors.append(error)
                else:
                    raise ProblemError(f"phase '{phase.name}' ({phase.source}): {errors[0]}") from errors[0]


def solve_implicit(K: Array, r0: Array) -> Array:
    """Return z = −K⁻¹ r0 for stacked nodes, (n, nz)."""
    if r0.shape[1] == 0:
        return r0
    return -np.linalg.solve(K, r0[:, :, None])[:, :, 0]


def check_controls(compiled: CompiledProblem) -> None:
    """Raise if some control has no running cost anywhere in a mode: its Hessian would be singular."""
    for mode in dict.fromkeys(phase.mode for phase in compiled.phases):
        if mode.nu == 0:
            continue
        ndx, curvature = mode.state.ndx, np.zeros(mode.nu)
        for phase in (p for p in compiled.phases if p.mode is mode):
            J = _derivatives(phase)["residual_w"][:, :, ndx:]
            curvature = np.maximum(curvature, np.einsum("nr,nru->nu", phase.weight, J**2).max(axis=0))
        for i in np.flatnonzero(curvature <= 0.0):
            label = mode.model.control.labels[i]
            raise ProblemError(
                f"model '{mode.model.name}', mode '{mode.key}': a control has no running cost - got none on '{label}', expected "
                f"at least a small one; add ocp.regularize({label.split()[0]}, weight=...)"
            )


def check_finite(compiled: CompiledProblem) -> None:
    """Raise if a value or derivative is NaN or infinite at the initial guess; name the term and the node."""
    for phase in compiled.phases:
        for results, group in ((_values(phase), "value"), (_derivatives(phase), "derivative")):
            for name, array in results.items():
                if np.all(np.isfinite(array)):
                    continue
                node, row = (int(i) for i in np.argwhere(~np.isfinite(array))[0][:2])
                if name.split("_")[0] in ("residual", "g", "h"):
                    owner: Row = phase.mode.rows[f"stage_{name.split('_')[0]}"][row]
                    source = f" ({compiled.terms[owner.term].source})" if owner.term >= 0 else ""
                    what = f"term '{compiled.row_name(owner)}'{source}"
                else:
                    what = f"dynamics of model '{phase.mode.model.name}' (function '{name}', row {row})"
                raise ProblemError(
                    f"{what}, phase '{phase.name}', node {node}: {group} at the initial guess is not finite - got NaN or "
                    "infinity, expected finite numbers; move the guess or the term away from the singularity"
                )


def _z(phase: CompiledPhase) -> Array:
    K, r0 = Batch(phase.mode.functions["implicit"])(phase.guess_states[:-1], phase.guess_controls, phase.p)
    try:
        return solve_implicit(K, r0)
    except np.linalg.LinAlgError:
        return np.full_like(r0, np.nan)


def _values(phase: CompiledPhase) -> dict[str, Array]:
    stage = phase.mode.functions["stage"]
    results = Batch(stage)(phase.guess_states[:-1], phase.guess_controls, _z(phase), phase.p)
    return dict(zip(stage.name_out(), results, strict=True))


def _derivatives(phase: CompiledPhase) -> dict[str, Array]:
    stage_d = phase.mode.functions["stage_d"]
    arguments = (phase.guess_states[:-1], phase.guess_controls, _z(phase), phase.p, phase.guess_states[1:])
    return dict(zip(stage_d.name_out(), Batch(stage_d)(*arguments), strict=True))
