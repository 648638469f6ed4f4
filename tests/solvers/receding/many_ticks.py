"""Many ticks of a receding horizon and its low level, in C and in NumPy from equal inputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piaffe import models, ocp, solvers

from .found import Found
from .schedules import Rng, kinds, quadruped, robot_terms
from .twins import compare, is_wild, make_equal, stop_at_once, twin_of


@dataclass
class Shown(Found):
    """The largest differences of many ticks, and what the low level met.

    Args:
        torque: difference relative to 1 + the largest control.
        controls: number of ticks of the low level. limited: those with active rows.
        fallbacks: those whose program has no solution. commands: changes of commands.
        restarts: times that the motion began again.
        adapted: plans after which rows have other numbers than at first.
    """

    torque: float = 0.0
    controls: int = 0
    limited: int = 0
    fallbacks: int = 0
    commands: int = 0
    restarts: int = 0
    adapted: int = 0


def cascade(motion: ocp.Motion) -> ocp.Problem:
    """Return a problem of the robot with two models."""
    body, srb = quadruped()
    objective, limits, effort = robot_terms()
    schedule = body.over(0.16, dt=0.01).without(effort) + srb.over(0.2, dt=0.05).without(limits)
    return ocp.Problem(motion, schedule, objective + effort, limits, initial=body.state(joints="stand"))


def commanded_gait() -> ocp.Problem:
    """Return a trot, whose commands change."""
    return cascade(models.gaits.trot(speed=0.4))


def pieces_with_impacts() -> ocp.Problem:
    """Return one cycle of a pace, a hop with a landing, and a bound."""
    stands = models.stance("FL FR HL HR")
    hop = ocp.Motion(
        ocp.Phase("push", stands, 0.12, ocp.Keyframe(position=(0.05, 0, 0.3))),
        ocp.Phase("air", models.stance(""), 0.1, ocp.Keyframe(position=(0.15, 0.02, 0.28), rpy=(0, 0, 0.2))),
        ocp.Phase("land", stands, 0.12, ocp.Keyframe(position=(0.15, 0.02, 0.26), rpy=(0, 0, 0.2))),
    )
    return cascade(models.gaits.pace(speed=0.3, stance_time=0.1).cycles(1) + hop + models.gaits.bound(speed=0.4))


def own_model() -> ocp.Problem:
    """Return a mass on a rope that tightens again and again: an implicit model with impacts."""
    kind = kinds()["rope"]
    thrown = ocp.Motion(
        ocp.Phase("throw", "slack", 0.3, {"place": (0.75, -0.6)}),
        ocp.Phase("swing", "taut", 0.4, {"place": (-0.6, -0.7)}),
        cyclic=True,
    )  # fmt: skip
    return ocp.Problem(thrown, kind.models[0].over(0.3, dt=0.01), *kind.terms, initial=kind.initial)


MOTIONS: dict[str, Callable[[], ocp.Problem]] = {
    "gait with commands": commanded_gait, "pieces with impacts": pieces_with_impacts, "own model": own_model,
}  # fmt: skip
EPISODES = {"pieces with impacts": 1.2}
"""Time after which a motion begins again [s]."""


def run(name: str, ticks: int, seed: int, barrier: solvers.Adapting | None = None) -> Shown:
    """Make ticks of a motion; raise AssertionError if C and NumPy differ, and return by how much they do."""
    rng, shown, declared = np.random.default_rng(seed), Shown(), MOTIONS[name]()
    native = solvers.RecedingHorizon(declared, iterations=1, first_iterations=30, latency=0.013, barrier=barrier)
    twin = twin_of(native)
    lows: list[solvers.Vwbc] = []
    x, t, lost = np.array(declared.initial), 0.0, False
    for k in range(ticks):
        if t > EPISODES.get(name, np.inf) or lost:
            x, t = np.array(declared.initial), 0.0
            native.reset(), twin.reset()
            shown.restarts += 1
        first = twin._numpy.plan is None
        if native.horizon.commands and rng.random() < 0.1:
            values = {key: value + 0.2 * rng.standard_normal() for key, value in native.horizon.commands.items()}
            values["height"] = native.horizon.commands["height"] + 0.01 * rng.standard_normal()
            native.command(**values), twin.command(**values)
            shown.commands += 1
        only_shifted = bool(not first and rng.random() < 0.15)
        stop_at_once(native, twin, stop=only_shifted)
        got, expected = native.plan(x, t), twin.plan(x, t)
        numbers, results = compare(got, expected, exact=only_shifted)
        shown.ticks, shown.numbers = shown.ticks + 1, max(shown.numbers, numbers)
        if only_shifted:
            shown.shift = max(shown.shift, results)
        else:
            shown.iteration = max(shown.iteration, results)
        shown.adapted += any((own.multipliers[row] != first).any() for own in expected.parts for row, first in (
            ("end_equality", 0.0), ("relaxation", native.options.relaxation)) if own.multipliers)  # fmt: skip
        lost = is_wild(expected)  # a robot with one iteration, and some without, may fall
        make_equal(native, got, twin, expected)
        if not lows:
            lows = [solvers.Vwbc(got, backend="native"), solvers.Vwbc(got, backend="numpy")]
        if got.has_policy:
            _follow(lows, got, rng, shown)
        later = t + (0.02 if k % 3 else 0.017)  # also off the grid of the model's steps
        x, t = _ahead(expected, max(round(later, 2), expected.start), rng), later
    shown.fallbacks = lows[0].fallbacks
    return shown


def _follow(lows: list[solvers.Vwbc], plan: solvers.Plan, rng: Rng, shown: Shown) -> None:
    """Compare the low level's ticks on a plan at three random times and states, the last far from the plan."""
    for low in lows:
        low.follow(plan)
    for size in (3e-3, 3e-3, 0.2):
        t = plan.start + 0.03 * rng.random()
        x = _ahead(plan, t, rng, size)
        own, other = (low.control(x, t) for low in lows)
        assert lows[0].last is not None
        assert lows[1].last is not None
        assert lows[0].last.status is lows[1].last.status
        assert set(lows[0].last.active) == set(lows[1].last.active)
        difference = float(np.abs(own - other).max() / (1 + np.abs(other).max()))
        assert difference < 1e-9, difference
        shown.torque = max(shown.torque, difference)
        shown.controls += 1
        shown.limited += bool(lows[0].last.active)


def _ahead(plan: solvers.Plan, t: float, rng: Rng, noise: float = 1e-3) -> np.ndarray:
    """Return a state of the plan at a later time, in the world, with noise."""
    own = [p for p in plan.parts if p.mode.state is plan.parts[0].mode.state and p.times[0] <= t + 1e-9]
    part = (own or [plan.parts[0]])[-1]
    k = int(np.clip(np.searchsorted(part.times, t - 1e-9), 0, len(part.times) - 1))
    space = part.mode.state
    return plan.world(space.np_plus(part.states[k], noise * rng.standard_normal(space.ndx)))
