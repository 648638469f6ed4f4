"""The three methods of a sampler, called and looked at: what they return has the right shapes and no NaN."""

from __future__ import annotations

from collections.abc import Mapping
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

_SUM = 1e-3  # how far the sum of weights may be from one; single precision and thousands of samples make 1e-4


def require_methods(kind: type, base: type) -> None:
    """Raise SamplingError unless a class has all three methods of its own or of a class between it and ``base``."""
    for name, form in METHODS.items():
        if getattr(kind, name) is getattr(base, name):
            raise SamplingError(
                f"controller '{kind.__name__}': has no method '{name}' - got a class without it, expected "
                f"{', '.join(METHODS)}; write `{form}`"
            )


# ---- calling them


def sampled(method: Method, xp: Any, plan: Any, noise: Any, stage: Stage, memory: Memory) -> Any:
    """Return the samples of a stage (N + 1, knots + 1, nu): what the sampler tries, and the plan itself.

    Samples are within the controls' range. Node 0 is being applied, so it is that of the plan.
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
    """Return what the sampler says that roll-outs return, (n,), and its memory."""
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
    """Return returns with the worst one in place of those of failed roll-outs, and which failed; 0 if all did."""
    failed = failed | ~xp.isfinite(returns)
    worst = xp.where(failed.all(), 0.0, xp.min(xp.where(failed, xp.inf, returns)))
    return xp.where(failed, worst, returns), failed


def unexplained(xp: Any, returns: Any, rolled: Rolled) -> Any:
    """Return which returns are not finite though all that they were made from is, (n,)."""
    sound = ~rolled.failed & xp.isfinite(rolled.cost).all(axis=1)
    for part in (rolled.last, rolled.value):
        sound = sound if part is None else sound & xp.isfinite(part)
    return sound & ~xp.isfinite(returns)


# ---- looking at what they returned


def require_explained(method: Method, odd: NDArray[np.bool_]) -> None:
    """Raise SamplingError if some returns are not finite without a reason, (n,)."""
    if odd.any():
        raise SamplingError(
            f"{_name(method)}: returns are not finite - got NaN or infinity for {int(odd.sum())} of {len(odd)} "
            "roll-outs whose costs are finite, expected numbers; look for divisions by zero and logarithms in returns"
        )


def require_sound(method: Method, staged: Staged) -> None:
    """Raise SamplingError unless plan, weights and memory of a stage are finite and weights are shares of one."""
    require_finite(method, "update", "plan", staged.plan)
    weights = np.asarray(staged.weights)
    if not (np.all(weights >= 0.0) and abs(float(weights.sum()) - 1.0) < _SUM):
        raise SamplingError(
            f"{_name(method)}: update, weights are no shares - got a sum of {float(weights.sum()):g} and a least one "
            f"of {float(weights.min()):g}, expected numbers that are not negative, with the sum 1; divide by their sum"
        )
    for name, kept in staged.memory.items():
        require_finite(method, "memory", f"'{name}'", kept)


def require_finite(method: Method, where: str, what: str, values: Any) -> None:
    """Raise SamplingError if an array has NaN or infinity."""
    numbers = np.asarray(values)
    with np.errstate(invalid="ignore", over="ignore"):
        total = np.sum(numbers)
    if not np.isfinite(total) and (count := int(np.sum(~np.isfinite(numbers)))):  # one pass where all is well
        raise SamplingError(
            f"{_name(method)}: {where}, {what} not finite - got NaN or infinity in {count} of {numbers.size} numbers, "
            f"expected none; look for divisions by zero and roots of negative numbers in {where}"
        )


def _name(method: Method) -> str:
    return f"controller '{type(method).__name__}'"


def _called(method: Method, where: str, xp: Any, *given: Any) -> Any:
    """Return what a method returns; within ``jit`` say by name what of it cannot be traced."""
    if xp is np:
        return getattr(method, where)(xp, *given)
    try:
        return getattr(method, where)(xp, *given)
    except (TypeError, IndexError) as error:  # what JAX raises for values that are not known yet
        raise SamplingError(
            f"{_name(method)}: {where} cannot be compiled by JAX - got {str(error).splitlines()[0]}, expected "
            "functions of xp on arrays, without if and without assignments in place; use xp.where and xp.sort, or "
            'choose engine="native"'
        ) from error


def _parts(method: Method, where: str, found: Any, count: int) -> tuple[Any, ...]:
    if not (isinstance(found, tuple) and len(found) == count):
        got = f"{len(found)} values" if isinstance(found, tuple) else type(found).__name__
        raise SamplingError(
            f"{_name(method)}: {where} gives something else - got {got}, expected {count} values; write "
            f"`{METHODS[where]}`"
        )
    return found


def _require_shape(method: Method, where: str, what: str, found: Any, expected: tuple[int, ...]) -> None:
    got = () if isinstance(found, int | float) else getattr(found, "shape", None)
    if got != tuple(expected):
        said = type(found).__name__ if got is None else str(tuple(got))
        raise SamplingError(
            f"{_name(method)}: {where}, {what} have the wrong shape - got {said}, expected {tuple(expected)}; return "
            "an array of this shape"
        )


def _require_memory(method: Method, where: str, found: Any, before: Memory) -> None:
    """Raise SamplingError unless what is remembered has the names and shapes that it had."""
    if not isinstance(found, Mapping) or set(found) != set(before):
        got = sorted(found) if isinstance(found, Mapping) else type(found).__name__
        raise SamplingError(
            f"{_name(method)}: {where}, memory has other names - got {got}, expected {sorted(before)} as in "
            "initial_memory; return all that is remembered, or memory as it was given"
        )
    for name, kept in before.items():
        _require_shape(method, where, f"memory '{name}'", found[name], np.shape(kept))
