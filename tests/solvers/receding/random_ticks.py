"""Random problems, shifted by random times: numbers as compiled afresh, and ticks in C as in NumPy."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from piaffe import ocp, solvers
from piaffe.errors import PiaffeError, ProblemError
from piaffe.ocp import CompiledProblem, Horizon
from piaffe.solvers.receding.numpy_tick import NumpyTick

from .schedules import Rng, kinds, own_problem, robot_problem

TABLES = ("times", "p", "g_mask", "h_mask", "p_transition")
ITERATES = ("states", "controls")
POLICY = ("feedforward", "feedback", "Q_x", "Q_u", "Q_xx", "Q_ux", "Q_uu")
COMPILED = ("times", "p", "p_end", "weight", "g_mask", "h_mask", "end_weight", "end_g_mask", "end_h_mask",
            "p_transition", "guess_states", "guess_controls")  # fmt: skip
BARRIERS = (None, solvers.Adapting(), solvers.Adapting(min_weight=0.005, max_stiffness=1e4, max_defect=1e3))
PLAIN = ("name", "label", "dt", "ends_phase", "resets", "lands", "mode", "transition")


@dataclass
class Found:
    """What random cases have shown: how many of each kind, and the largest differences.

    Args:
        refused: problems that are refused by name.
        compiled: horizons that are compared with the compiler.
        ticks: plans in C that are compared with those in NumPy; ``wild`` ones by their numbers alone.
        numbers: difference of parameters, masks, times, guesses.
        shift: difference of a plan that is only shifted, relative to 1 + its largest number.
        iteration: difference after an iteration from equal inputs, relative likewise.
    """

    refused: int = 0
    compiled: int = 0
    ticks: int = 0
    wild: int = 0
    numbers: float = 0.0
    shift: float = 0.0
    iteration: float = 0.0


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
        _numbers(mpc.horizon, rng, found, cycles)
        _ticks(mpc, rng, found)
    except AssertionError as error:
        raise AssertionError(f"{name}, seed {seed}: {error}") from error


def assert_form(error: PiaffeError, seed: int) -> None:
    """Raise unless the message of an error has the usual form: where, what is wrong, got, expected, what to do."""
    text = str(error)
    parts = [": ", " - got ", ", expected ", "; "]
    places = [text.find(part) for part in parts]
    assert min(places) > 0, f"seed {seed}: {text}"


# ---- numbers


def _numbers(horizon: Horizon, rng: Rng, found: Found, cycles: int) -> None:
    """Compare the horizon at random times with the compiler, where the declared path is that of the horizon."""
    calendar, problem = horizon.calendar, horizon.problem
    ahead = sum(w if w is not None else 0 for w in horizon.layout.windows)
    for _ in range(2):
        total = min(calendar.total, cycles * sum(entry.length for entry in calendar.entries)) - ahead
        count = int(total // calendar.steps[0])
        if count < 0:
            return
        t = int(rng.integers(count + 1)) * horizon.dt
        place = calendar.at(horizon.tick_of(t))
        piece = calendar.entries[place.entry].placed.piece
        if horizon.courses.pieces[piece].functions is not None and t > 0:
            continue  # functions go on from the measured state
        x, first = _on_path(horizon, t), ceil(calendar.firsts[piece][1] / calendar.steps[0]) * horizon.dt
        course = horizon.advance(horizon.begin(_on_path(horizon, first), first), x, t)  # frames of later cycles differ
        got = horizon.at(course, horizon.local(course, x))
        try:
            expected = ocp.compile_problem(problem, t, checks=False)
        except ProblemError as error:
            if "applies nowhere" not in str(error):  # a term may, in this part of the motion
                raise
            continue
        found.numbers = max(found.numbers, _difference(got, expected.with_start(x), functions=_has_functions(horizon)))
        found.compiled += 1


def _has_functions(horizon: Horizon) -> bool:
    return any(piece.functions is not None for piece in horizon.courses.pieces)


def _on_path(horizon: Horizon, t: float) -> np.ndarray:
    path, model = horizon._compilation.path, horizon.models[0]
    sample = path.sample(t, path.interval_at(t))
    start = horizon._compilation.start
    blocks = {b.quantity: sample.get(b.quantity, start.get(b.quantity)) for b in model.state.blocks}
    return model.state.np_normalise(model.state.pack(blocks))


def _difference(got: CompiledProblem, expected: CompiledProblem, functions: bool) -> float:
    most = 0.0
    assert len(got.phases) == len(expected.phases)
    for own, other in zip(got.phases, expected.phases, strict=True):
        assert [getattr(own, name) for name in PLAIN] == [getattr(other, name) for name in PLAIN]
        for name in COMPILED:
            a, b = getattr(own, name), getattr(other, name)
            assert a.shape == b.shape, name
            if name == "guess_controls" and functions:
                continue  # a guess of forces looks along the declared path
            difference = float(np.abs(_one_sign(a, own, name) - _one_sign(b, own, name)).max(initial=0.0))
            if name == "guess_controls":  # a least-squares solution
                assert difference < 1e-6 * (1 + np.abs(b).max(initial=0.0)), (own.name, name, difference)
                continue
            difference /= max(1.0, float(np.abs(b).max(initial=0.0)))  # random keyframes ask for 100 m/s
            assert difference < 1e-9, (own.name, name, difference)
            most = max(most, difference)
    return most


def _one_sign(values: np.ndarray, phase: ocp.CompiledPhase, name: str) -> np.ndarray:
    """Return numbers in which quaternions, whose sign means nothing, have their largest entry positive."""
    parts: list[slice] = []
    if name == "guess_states":
        space = phase.mode.state
        parts = [part for quantity, part in space.slices.items() if quantity.kind == "rotation"]
    elif name in ("p", "p_end", "p_transition"):
        layout = phase.mode.layout if name != "p_transition" else phase.transition.layout if phase.transition else None
        parts = [] if layout is None else [p for key, p in layout.slices.items() if key.kind == "target"]
        parts = [part for part in parts if part.stop - part.start == 4]
    out = np.array(np.atleast_2d(values), dtype=float)
    for part in parts:
        own = out[:, part]
        largest = np.take_along_axis(own, np.abs(own).argmax(axis=1)[:, None], axis=1)
        own *= np.where(largest < 0, -1.0, 1.0)
    return out


# ---- ticks


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
