"""The natural size of a problem's cost, to which barrier, penalties and regularisation of a solve are relative."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from piaffe.ocp import CompiledProblem

from .. import constants
from .iterate import Iterate, PhaseDual, PhaseValues, ProblemFunctions, running_cost
from .options import Options
from .riccati import LqPhase, backward, roll_out

_SHARE = 0.65
"""The scale is this share of the predicted cost: gaits and rolls of quadrupeds have scales of 1 to 10 with it."""
_USUAL_S = 3.0  # duration of a horizon up to which the first barrier weight is relative to the whole scale [s]
_LEAST, _LARGEST = 1e-6, 10.0
"""Limits of the scale, relative to the cost of residuals that are all 1: that of residuals of a thousandth, and one
because a quadratic model far from its guess predicts costs that nothing has."""


def natural_time(problem: CompiledProblem) -> float:
    """Return the natural time of a problem's first model [s]."""
    return problem.phases[0].mode.model.sizes.time


def cost_scale(functions: ProblemFunctions) -> float:
    """Return the natural size of a problem's cost, proportional to the weights; 1 if no term has a weight.

    It is a share of the declared cost that the quadratic model predicts after one full step from the guess. In the
    model, equalities and violated inequalities have penalties as large as all weights together. So it is the size of a
    cost near the optimum, also where the cost of the guess is zero. It depends on neither options nor a warm start.

    Args:
        functions: the problem's functions.
    """
    problem, unit = functions.problem, unit_cost(functions.problem)
    time = natural_time(problem)
    if unit <= 0:
        return 1.0
    at = Iterate([p.guess_states for p in problem.phases], [p.guess_controls for p in problem.phases])
    values = functions.all_values(at)
    defects = functions.defects(at, values)

    def models(penalty: float) -> list[LqPhase]:
        weight = penalty / time * constants.SCALE_RELAXATION**2
        duals = [_penalties(value, penalty, time) for value in values]
        return [functions.lq(i, at, values[i], defects[i], duals[i], weight) for i in range(len(duals))]

    cost, predicted = sum(running_cost(p, v) for p, v in zip(problem.phases, values, strict=True)), np.nan
    sweeps = backward(models(constants.SCALE_PENALTY * unit), constants.SCALE_RIDGE * unit)
    if sweeps is not None:
        step = roll_out(models(0.0), sweeps)
        predicted = cost + step.dV1 + 0.5 * step.dV2
    return scale_of(predicted, unit)


def scaled(options: Options, problem: CompiledProblem, scale: Callable[[], float]) -> Options:
    """Return options for costs in the problem's unit.

    The barrier is an integral over time. So its first weight is relative to the scale by time where the horizon is
    longer than three seconds, which gaits, rolls and jumps are not.

    Args:
        options: options, relative to the scale of the cost. Without ``adapt`` and without a scale of their own they are
            not changed.
        problem: the problem.
        scale: called for the scale of the problem, if the options have none.
    """
    time = natural_time(problem) if options.time_scale is None else options.time_scale
    if options.cost_scale is not None:
        return options.absolute(options.cost_scale, time)
    if not options.adapt:
        return options
    absolute = options.absolute(scale(), time)
    duration = sum(phase.dt * phase.num_stages for phase in problem.phases) / time
    return replace(absolute, barrier_weight=absolute.barrier_weight * min(1.0, _USUAL_S / duration))


def unit_cost(problem: CompiledProblem) -> float:
    """Return the cost of residuals that all have their natural size, which is 1 in SI units for most models."""
    total = 0.0
    for p in problem.phases:
        size = p.mode.model.sizes.of
        stage = np.array([size(row.unit) for row in p.mode.rows["stage_residual"]]) ** 2
        end = np.array([size(row.unit) for row in p.end_rows("residual")]) ** 2
        total += 0.5 * (p.dt * np.sum(p.weight * stage) + np.sum(p.end_weight * end))
    return float(total)


def scale_of(predicted: float, unit: float) -> float:
    """Return the scale of a predicted cost, rounded so that both backends have the same.

    Args:
        predicted: the cost; NaN or infinite if there is none.
        unit: the cost of residuals that are all 1; 0 if no term has a weight.
    """
    if unit <= 0:
        return 1.0
    share = float(np.float32(_SHARE * predicted / unit)) if np.isfinite(predicted) else 0.0
    return min(max(share, _LEAST), _LARGEST) * unit


def _penalties(value: PhaseValues, penalty: float, time: float) -> PhaseDual:
    g, end_g, h, end_h = value.g, value.end_g, value.h, value.end_h
    delta = constants.SCALE_RELAXATION
    return PhaseDual(
        relaxation=np.full_like(g, delta), end_relaxation=np.full_like(end_g, delta), shift=np.zeros_like(g),
        end_shift=np.zeros_like(end_g), multiplier=np.zeros_like(h), penalty=np.full_like(h, penalty / time),
        end_multiplier=np.zeros_like(end_h), end_penalty=np.full_like(end_h, penalty),
    )  # fmt: skip
