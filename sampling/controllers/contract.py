"""Calls of the three methods of a sampler, with checks that their results have the right shapes and no NaN."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SamplingError

from .stage import Memory, Method, Rolled, Stage, Staged

METHODS: Mapping[str, str] = {
    "sample": "def sample(self, xp, plan, noise, stage, memory): return samples",
    "returns": "def returns(self, xp, rolled, memory): return returns, memory",
    "update": "def update(self, xp, samples, returns, memory): return plan, weights, memory",
}
"""The methods of a sampler: arguments and results."""

_SUM = 1e-3  # largest error of the sum of weights; in single precision, thousands of samples give 1e-4


def require_methods(kind: type, base: type) -> None:
    """Raise SamplingError unless a class, or a class between it and ``base``, defines all three methods."""
    for name, form in METHODS.items():
        if getattr(kind, name) is getattr(base, name):
            raise SamplingError(
                f"controller '{kind.__name__}': has no method '{name}' - got a class without it, expected "
                f"{', '.join(METHODS)}; write `{form}`"
            )


# ---- calls of the methods


def sampled(method: Method, xp: Any, plan: Any, noise: Any, stage: Stage, memory: Memory) -> Any:
    """Return the samples of a stage (N + 1, knots + 1, nu): those of the sampler, and the current plan.

    Samples are clipped to the controls' range. Node 0 is that of the plan, because its control is applied already.
    """
    tried = _called(method, "sample", xp, plan, noise, stage, memory)
    _require_shape(method, "sample", "samples", tried, noise.shape)
    if xp is np:
        require_finite(method, "sample", "samples", tried)
        samples = np.empty((len(tried) + 1, *plan.shape))  # what follows, without copies
        np.clip(tried, -1.0, 1.0, out=samples[:-1])
        samples[:, 0], samples[-1] = plan[0], plan
        return samples
    free = xp.concatenate([xp.clip(tried[:, 1:], -1.0, 1.0), plan[None, 1:]])
    return xp.concatenate([xp.broadcast_to(plan[0], (len(free), 1, plan.shape[1])), free], axis=1)


def returned(method: Method, xp: Any, rolled: Rolled, memory: Memory) -> tuple[Any, Memory]:
    """Return the sampler's returns of the roll-outs, (n,), and its memory."""
    found, kept = _parts(method, "returns", _called(method, "returns", xp, rolled, memory), 2)
    _require_shape(method, "returns", "returns", found, rolled.failed.shape)
    _require_memory(method, "returns", kept, memory)
    return found, kept


def updated(method: Method, xp: Any, samples: Any, returns: Any, memory: Memory) -> tuple[Any, Any, Memory]:
    """Return the sampler's plan (knots + 1, nu), the weights of samples (n,), and its memory."""
    plan, weights, kept = _parts(method, "update", _called(method, "update", xp, samples, returns, memory), 3)
    _require_shape(method, "update", "plan", plan, samples.shape[1:])
    _require_shape(method, "update", "weights", weights, returns.shape)
    _require_memory(method, "update", kept, memory)
    return plan, weights, kept


def settled(xp: Any, returns: Any, failed: Any) -> tuple[Any, Any]:
    """Return the returns, with the lowest one for failed roll-outs (0 if all failed), and which roll-outs failed."""
    if xp is np and isfinite(returns.sum()) and not failed.any():  # as a rule; the rest would be without effect
        return returns, failed
    failed = failed | ~xp.isfinite(returns)
    worst = xp.where(failed.all(), 0.0, xp.min(xp.where(failed, xp.inf, returns)))
    return xp.where(failed, worst, returns), failed


def unexplained(xp: Any, returns: Any, rolled: Rolled) -> Any:
    """Return which returns are not finite although cost, end cost and value of the roll-out are finite, (n,)."""
    sound = ~rolled.failed & xp.isfinite(rolled.cost).all(axis=1)
    for part in (rolled.last, rolled.value):
        sound = sound if part is None else sound & xp.isfinite(part)
    return sound & ~xp.isfinite(returns)


# ---- checks of the results


def require_explained(method: Method, odd: NDArray[np.bool_]) -> None:
    """Raise SamplingError if returns are not finite without a reason; see :func:`unexplained`, (n,)."""
    if odd.any():
        raise SamplingError(
            f"{_name(method)}: returns are not finite - got NaN or infinity for {int(odd.sum())} of {len(odd)} "
            "roll-outs whose costs are finite, expected numbers; check divisions and logarithms in returns"
        )


def require_sound(method: Method, staged: Staged) -> None:
    """Raise SamplingError unless plan and memory of a stage are finite, and the weights are not negative with sum 1."""
    weights = np.asarray(staged.weights)
    with np.errstate(invalid="ignore", over="ignore"):
        sums = [np.sum(np.asarray(each)) for each in (staged.plan, *staged.memory.values())]  # JAX would round them
        if all(map(isfinite, sums)) and weights.min() >= 0.0 and abs(weights.sum() - 1.0) < _SUM:
            return  # as a rule; what follows finds out what is wrong
    require_finite(method, "update", "plan", staged.plan)
    if not (np.all(weights >= 0.0) and abs(float(weights.sum()) - 1.0) < _SUM):
        raise SamplingError(
            f"{_name(method)}: update, weights are no shares - got the sum {float(weights.sum()):g} and the minimum "
            f"{float(weights.min()):g}, expected numbers that are not negative, with the sum 1; divide by their sum"
        )
    for name, kept in staged.memory.items():
        require_finite(method, "returns or update", f"memory '{name}'", kept)


def require_finite(method: Method, where: str, what: str, values: Any) -> None:
    """Raise SamplingError if an array contains NaN or infinity."""
    numbers = np.asarray(values)
    with np.errstate(invalid="ignore", over="ignore"):
        total = np.sum(numbers)
    if not np.isfinite(total) and (
        count := int(np.sum(~np.isfinite(numbers)))
    ):  # only one pass if all numbers are finite
        raise SamplingError(
            f"{_name(method)}: {where}, {what} not finite - got NaN or infinity in {count} of {numbers.size} numbers, "
            f"expected none; check divisions and square roots in {where}"
        )


def _name(method: Method) -> str:
    return f"controller '{type(method).__name__}'"


def _called(method: Method, where: str, xp: Any, *given: Any) -> Any:
    """Return the result of a method; if JAX cannot trace the method, raise an error that names it."""
    if xp is np:
        return getattr(method, where)(xp, *given)
    try:
        return getattr(method, where)(xp, *given)
    except (TypeError, IndexError) as error:  # errors of JAX for a Python operation on traced values
        raise SamplingError(
            f"{_name(method)}: {where} cannot be compiled by JAX - got {str(error).splitlines()[0]}, expected "
            "functions of xp on arrays, without if and without assignments in place; use xp.where and xp.sort, or "
            'choose engine="native"'
        ) from error


def _parts(method: Method, where: str, found: Any, count: int) -> tuple[Any, ...]:
    if not (isinstance(found, tuple) and len(found) == count):
        got = f"{len(found)} values" if isinstance(found, tuple) else type(found).__name__
        raise SamplingError(
            f"{_name(method)}: {where} has a wrong result - got {got}, expected {count} values; write "
            f"`{METHODS[where]}`"
        )
    return found


def _require_shape(method: Method, where: str, what: str, found: Any, expected: tuple[int, ...]) -> None:
    got = () if isinstance(found, int | float) else getattr(found, "shape", None)
    if got != tuple(expected):
        shown = type(found).__name__ if got is None else str(tuple(got))
        raise SamplingError(
            f"{_name(method)}: {where}, {what} have the wrong shape - got {shown}, expected {tuple(expected)}; return "
            "an array of this shape"
        )


def _require_memory(method: Method, where: str, found: Any, before: Memory) -> None:
    """Raise SamplingError unless the names and shapes in the memory are the same as before."""
    if not isinstance(found, Mapping) or set(found) != set(before):
        got = sorted(found) if isinstance(found, Mapping) else type(found).__name__
        raise SamplingError(
            f"{_name(method)}: {where}, memory has other names - got {got}, expected {sorted(before)} as in "
            "initial_memory; return all that is remembered, or memory as it was given"
        )
    for name, kept in before.items():
        _require_shape(method, where, f"memory '{name}'", found[name], np.shape(kept))
