"""Random problems, shifted by random times: numbers as compiled afresh, and ticks in C as in NumPy."""

from __future__ import annotations

from math import ceil

import numpy as np

from piaffe import solvers
from piaffe.errors import PiaffeError, ProblemError

from .found import Found, assert_form
from .horizon_numbers import compare_numbers
from .schedules import Rng, kinds, own_problem, robot_problem
from .twins import compare, is_wild, make_equal, stop_at_once, twin_of

BARRIERS = (None, solvers.Adapting(), solvers.Adapting(min_weight=0.005, max_stiffness=1e4, max_defect=1e3))


def random_case(seed: int, found: Found, *, robot: bool = False, kind: str | None = None, cycles: int = 12) -> None:
    """Make a random problem, and check it; raise AssertionError with the seed if something differs.

    Args:
        seed: of its random numbers.
        found: what is found is added to it.
        robot: whether it is a robot's.
        kind: its structure; by default a random one.
        cycles: of an endless motion's tables, after which no horizon is compared with the compiler.
    """
    rng = np.random.default_rng(seed)
    name = "robot" if robot else kind or str(rng.choice([*kinds()]))
    declared = robot_problem(rng) if robot else own_problem(name, rng)
    steps = int(rng.integers(1, 4))
    period = steps * declared.schedule.segments[0].dt
    latency = float(rng.choice([0.0, 0.0, 0.7 * declared.schedule.segments[0].dt, period]))
    try:
        mpc = solvers.RecedingHorizon(
            declared, period=period, latency=latency, first_iterations=1, iterations=1, barrier=BARRIERS[seed % 3]
        )
    except PiaffeError as error:
        assert_form(error, seed)
        found.refused += 1
        return
    try:
        compare_numbers(mpc.horizon, rng, found, cycles)
        _ticks(mpc, rng, found)
    except AssertionError as error:
        raise AssertionError(f"{name}, seed {seed}: {error}") from error


def _ticks(native: solvers.RecedingHorizon, rng: Rng, found: Found) -> None:
    """Make plans in C and in NumPy at random times; compare them, and give the next ones equal inputs."""
    twin, horizon = twin_of(native), native.horizon
    dt, space, head = horizon.dt, horizon.models[0].state, horizon.models[0]
    most = 20 * sum(entry.length for entry in horizon.calendar.entries) * horizon.calendar.tick
    last = min(horizon.duration, most)
    t = float(rng.integers(max(int(last / dt), 1))) * dt if rng.random() < 0.8 else 0.0
    x = space.np_plus(native.problem.initial, 0.02 * rng.standard_normal(space.ndx))
    if head.planar_pose is not None:
        x = horizon.courses.moved(x, tuple(rng.uniform((-5, -5, -3), (5, 5, 3))))
    for k in range(4):
        stop_at_once(native, twin, stop=k % 2 == 0)
        if k and horizon.commands and rng.random() < 0.5:
            values = {name: value + 0.2 * rng.standard_normal() for name, value in horizon.commands.items()}
            native.command(**values)
            twin.command(**values)
        plans = []
        for each in (native, twin):
            try:
                plans.append(each.plan(x, t))
            except ProblemError as error:
                assert_form(error, -1)
                plans.append(None)
        got, expected = plans
        assert (got is None) == (expected is None)
        if got is None:
            assert ceil((t + native.latency) / dt - 1e-6) * dt > horizon.duration - dt + 1e-6
            return
        found.ticks += 1
        found.wild += is_wild(expected)
        most_numbers, most_results = compare(got, expected, exact=k > 0 and k % 2 == 0)
        found.numbers = max(found.numbers, most_numbers)
        if k and k % 2 == 0:
            found.shift = max(found.shift, most_results)
        else:
            found.iteration = max(found.iteration, most_results)
        if is_wild(expected):
            return  # the next states would be those of a robot in the sky
        make_equal(native, got, twin, expected)
        t, x = _later(expected, t, rng, native)


def _later(plan: solvers.Plan, t: float, rng: Rng, mpc: solvers.RecedingHorizon) -> tuple[float, np.ndarray]:
    """Return a later time, also off the grid or far beyond the plan, and a state near the plan's."""
    dt = mpc.horizon.dt
    kind = rng.random()
    most = 4.0 if mpc.horizon.commands or kind < 0.8 else 60.0  # a robot's feet would be out of reach
    step = float(rng.integers(0, 4)) if kind < 0.5 else most * rng.random()
    later = max(t + step * dt, plan.start - mpc.latency)
    part = [p for p in plan.parts if p.times[0] <= later + 1e-9 and p.mode.state is plan.parts[0].mode.state][-1:]
    part = part or [plan.parts[0]]
    k = int(np.clip(np.searchsorted(part[0].times, later), 0, len(part[0].times) - 1))
    space = part[0].mode.state
    return later, plan.world(space.np_plus(part[0].states[k], 1e-3 * rng.standard_normal(space.ndx)))
