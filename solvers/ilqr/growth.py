"""Describe a linear-quadratic model whose value function grows beyond bounds: by phase, with times and direction."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import CompiledPhase

from .iterate import Iterate, ProblemFunctions
from .outer import Outer
from .riccati import LqPhase

Array = NDArray[np.float64]

_LARGEST = 1e10
"""Largest entry of V_xx, relative to the costs' own second derivatives, that leaves a sweep enough correct digits."""
_NAMED = 2
"""How many components of the direction are named."""


def growth(functions: ProblemFunctions, iterate: Iterate, outer: Outer) -> str:
    """Return a sentence about the phase in which the value function grows most; empty if it stays within bounds.

    The sweep has no regularisation. It ends where Q_uu is not positive definite, because rounding hides it.

    Args:
        functions: the problem's functions.
        iterate: the iterate at which a solve ended.
        outer: its barrier and multipliers.
    """
    with np.errstate(all="ignore"):
        return _growth(functions, iterate, outer)


def _growth(functions: ProblemFunctions, iterate: Iterate, outer: Outer) -> str:
    phases, values = functions.problem.phases, functions.all_values(iterate)
    defects = functions.defects(iterate, values)
    models = [functions.lq(i, iterate, values[i], defects[i], outer.duals[i], outer.weight) for i in range(len(phases))]
    if not all(model.is_finite for model in models):
        return ""
    units = [np.outer(phase.mode.state_sizes, phase.mode.state_sizes) for phase in phases]
    scale = max(_size(part * u) for model, u in zip(models, units, strict=True) for part in (model.l_xx, model.end_xx))
    largest, steepest, found, V = scale, 0.0, "", None
    for phase, model, unit in zip(reversed(phases), reversed(models), reversed(units), strict=True):
        trail = list(_backward(model, V))
        before, (node, V) = max(_size(trail[0][1] * unit), scale), trail[-1]
        grown = V * unit
        largest = max(largest, _size(grown))
        if _size(grown) > steepest * before:
            steepest, found = _size(grown) / before, _sentence(phase, before, node, grown)
        if node > 0:
            break
    return found if largest > _LARGEST * scale else ""


def _backward(model: LqPhase, following: Array | None) -> Iterator[tuple[int, Array]]:
    """Yield node and V_xx of a phase, from its last node to its first, or to the last that can be computed.

    Args:
        model: the linear-quadratic model of the phase.
        following: V_xx of the next phase's first node; None at the horizon's end.
    """
    V = model.end_xx
    if model.P is not None and following is not None:
        V = V + model.P.T @ following @ model.P
    yield len(model.A), V
    for i in range(len(model.A) - 1, -1, -1):
        A, B = model.A[i], model.B[i]
        Q_uu, Q_ux, Q_xx = model.l_uu[i] + B.T @ V @ B, model.l_ux[i] + B.T @ V @ A, model.l_xx[i] + A.T @ V @ A
        try:
            half = np.linalg.solve(np.linalg.cholesky(0.5 * (Q_uu + Q_uu.T)), Q_ux)
        except np.linalg.LinAlgError:
            return
        V = Q_xx - half.T @ half
        V = 0.5 * (V + V.T)
        yield i, V


def _sentence(phase: CompiledPhase, before: float, node: int, V: Array) -> str:
    direction = np.abs(np.linalg.eigh(V)[1][:, -1])
    labels = [phase.mode.state.labels[i].strip() for i in np.argsort(-direction)[:_NAMED]]
    return (
        f"In phase '{phase.name}' ({phase.label}) the value function grows from {before:.1e} at {phase.times[-1]:.4g} "
        f"s backwards to {_size(V):.1e} at {phase.times[node]:.4g} s, mainly along "
        f"{' and '.join(repr(label) for label in labels)}: the controls do not stop deviations there."
    )


def _size(matrix: Array) -> float:
    return float(np.max(np.abs(matrix), initial=0.0))
