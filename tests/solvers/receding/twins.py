"""Planners in C and in NumPy of one horizon: equal inputs, and the differences of their plans."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np

from piaffe import solvers
from piaffe.solvers.receding.numpy_tick import NumpyTick

TABLES = ("times", "p", "g_mask", "h_mask", "p_transition")
ITERATES = ("states", "controls")
POLICY = ("feedforward", "feedback", "Q_x", "Q_u", "Q_xx", "Q_ux", "Q_uu")


def twin_of(mpc: solvers.RecedingHorizon) -> solvers.RecedingHorizon:
    """Return a planner in NumPy with the same horizon."""
    other = copy.copy(mpc)
    below = mpc._native.memory.c.adapt_below
    other._native, other._numpy, other._commands = None, NumpyTick(mpc.horizon, mpc.options, None, below), {}
    return other


def stop_at_once(native: solvers.RecedingHorizon, twin: solvers.RecedingHorizon, *, stop: bool) -> None:
    """Let later plans make no iteration, so that they are the shifted ones, or let them make theirs."""
    native._native.memory.c.options.time_limit_s = 1e-12 if stop else 0.0
    twin._numpy.options = replace(native.options, time_limit_s=1e-12 if stop else None)


def is_wild(plan: solvers.Plan) -> bool:
    """Return whether a plan is so far from a motion that rounding decides: it diverges from a start at random."""
    return not plan.max_defect < 100.0


def compare(got: solvers.Plan, expected: solvers.Plan, *, exact: bool) -> tuple[float, float]:
    """Return the largest differences of numbers, and of results relative to their size; raise if they are too large.

    Args:
        got: in C.
        expected: in NumPy.
        exact: whether the iterate is only shifted.
    """
    assert [(p.segment, p.number, p.name, p.mode, p.transition, p.resets) for p in got.parts] == [
        (p.segment, p.number, p.name, p.mode, p.transition, p.resets) for p in expected.parts
    ]
    assert got.iterations == expected.iterations
    assert got.has_policy == expected.has_policy
    assert (got.start, got.measured_at) == (expected.start, expected.measured_at)
    numbers, results, wild = 0.0, 0.0, is_wild(expected)
    for own, other in zip(got.parts, expected.parts, strict=True):
        for names, tolerance in ((TABLES, 1e-9), (ITERATES, 1e-9 if exact else 1e-8), (POLICY, 1e-8)):
            if wild and not (names is TABLES or (exact and names is ITERATES)):
                continue
            for name in names:
                a, b = getattr(own, name), getattr(other, name)
                assert a.shape == b.shape, name
                size = 1.0 if names is TABLES else 1.0 + np.abs(b).max(initial=0.0)
                difference = float(np.abs(a - b).max(initial=0.0)) / size
                assert difference < tolerance, (own.name, name, difference)
                if names is TABLES:
                    numbers = max(numbers, difference)
                elif not exact or names is ITERATES:
                    results = max(results, difference)
        if not wild or exact:
            results = max(results, _difference_of_rows(own, other, 1e-9 if exact else 1e-8))
    assert got.barrier_weight == expected.barrier_weight
    return numbers, results


def _difference_of_rows(own: solvers.PlannedPhase, other: solvers.PlannedPhase, tolerance: float) -> float:
    """Return the largest difference of the numbers of rows, relative to their size; raise if it is too large."""
    assert own.multipliers.keys() == other.multipliers.keys()
    most = 0.0
    for name, a in own.multipliers.items():
        b = other.multipliers[name]
        assert a.shape == b.shape, name
        difference = float(np.abs(a - b).max(initial=0.0)) / (1.0 + float(np.abs(b).max(initial=0.0)))
        assert difference < tolerance, (own.name, name, difference)
        most = max(most, difference)
    return most


def make_equal(
    native: solvers.RecedingHorizon, got: solvers.Plan, twin: solvers.RecedingHorizon, expected: solvers.Plan
) -> None:
    """Give the next tick in C the inputs of the one in NumPy; without this, rounding errors grow from tick to tick."""
    for own, other in zip(got.parts, expected.parts, strict=True):
        own.states[:], own.controls[:], own.feedback[:] = other.states, other.controls, other.feedback
        for name, values in own.multipliers.items():
            values[:] = other.multipliers[name]
    outer = twin._numpy.outer
    if outer is not None:
        native._native.memory.c.last_equality = outer.last_equality
    course = twin._numpy.course
    if course is not None:
        native._native.memory.memory[: course.memory.size] = course.memory
