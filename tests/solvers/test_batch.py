"""Batches: equal to solving one by one, whatever the threads; refused whole; stopped cleanly."""

import _thread
import re
import threading
import time
from functools import cache

import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import PiaffeError, ProblemError, ShapeError, SolverError, UnknownNameError
from piaffe.ocp import CompiledProblem, compile_problem
from piaffe.solvers import BatchSolution, MSiLQR, Options, Solution, Status, solve_batch
from piaffe.solvers.ilqr.native.backend import native_memory
from piaffe.solvers.ilqr.native.memory import SolverMemory

from ..problems import PROBLEMS

BACKENDS = ("native", "numpy")
pytestmark = pytest.mark.filterwarnings("ignore::piaffe.codegen.NoCompilerWarning")
BATCH = 5


@cache
def rope() -> CompiledProblem:
    return compile_problem(PROBLEMS["rope"]())


@cache
def hopper() -> CompiledProblem:
    return compile_problem(PROBLEMS["hopper"]())


@cache
def varied() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Starts, masses, limits and a weight of ropes."""
    random = np.random.default_rng(4)
    starts = rope().initial + 0.02 * random.standard_normal((BATCH, 4))
    limits = random.uniform(2.9, 3.2, (BATCH, 2))
    numbers = {
        "rope.mass": random.uniform(1.9, 2.1, BATCH), "force limit.upper": limits, "force limit.lower": -limits,
        "track place at end.weight": random.uniform(30, 50, (BATCH, 2)),
    }  # fmt: skip
    return starts, numbers


def row(numbers: dict[str, np.ndarray], i: int) -> dict[str, np.ndarray]:
    return {name: np.atleast_1d(table[i]) for name, table in numbers.items()}


@cache
def one_by_one(backend: str) -> tuple[Solution, ...]:
    starts, numbers = varied()
    return tuple(
        MSiLQR(rope().with_parameters(row(numbers, i)).with_start(starts[i]), backend=backend).solve()
        for i in range(BATCH)
    )


def assert_row(batch: BatchSolution, i: int, alone: Solution) -> None:
    """Row i is a solution: to the bit where the solver's own numbers are, but for sums that NumPy repeats."""
    assert batch.status[i] is alone.status
    assert batch.iterations[i] == alone.iterations
    assert batch.barrier_weight[i] == alone.barrier_weight
    for name in ("cost", "max_defect", "max_equality", "max_inequality"):
        assert getattr(batch, name)[i] == pytest.approx(getattr(alone, name), rel=1e-9, abs=1e-12)
    for phase, part, policy in zip(batch.phases, alone.trajectory.phases, alone.phases, strict=True):
        np.testing.assert_array_equal(phase.states[i], part.states)
        np.testing.assert_array_equal(phase.controls[i], part.controls)
        for name, table in phase.multipliers.items():
            np.testing.assert_array_equal(table[i], policy.multipliers[name], err_msg=name)


# ---- what it finds


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("backend", BACKENDS)
def test_batch_is_its_instances_one_by_one(backend: str, threads: int) -> None:
    batch = solve_batch(rope(), *varied(), backend=backend, threads=threads)
    assert len(batch) == BATCH
    assert len(set(batch.cost)) == BATCH
    for i, alone in enumerate(one_by_one(backend)):
        assert_row(batch, i, alone)
    assert batch.converged.all()
    assert batch.raise_if_failed() is batch
    assert f"{BATCH} of {BATCH} converged" in str(batch)


def test_backends_agree() -> None:
    native, numpy = (solve_batch(rope(), *varied(), backend=backend) for backend in BACKENDS)
    np.testing.assert_array_equal(native.iterations, numpy.iterations)
    np.testing.assert_allclose(native.cost, numpy.cost, rtol=1e-6)
    np.testing.assert_allclose(native.states, numpy.states, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(native.controls, numpy.controls, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("backend", BACKENDS)
def test_shapes_and_gains(backend: str) -> None:
    compiled, (starts, _) = rope(), varied()
    batch = solve_batch(compiled, starts[:2], options=Options(max_iterations=3), backend=backend, gains=True)
    assert batch.states.shape == (2, sum(p.num_stages + 1 for p in compiled.phases), 4)
    assert batch.controls.shape == (2, compiled.num_stages, 2)
    for i in range(2):
        alone = MSiLQR(compiled.with_start(starts[i]), Options(max_iterations=3), backend=backend).solve()
        for phase, policy in zip(batch.phases, alone.phases, strict=True):
            np.testing.assert_allclose(phase.feedback[i], policy.feedback, rtol=1e-6, atol=1e-8)
            np.testing.assert_allclose(phase.feedforward[i], policy.feedforward, rtol=1e-5, atol=1e-8)
    assert solve_batch(compiled, starts[:1], options=Options(max_iterations=1)).phases[0].feedback is None
    assert batch.status == (Status.ITERATION_LIMIT,) * 2
    with pytest.raises(SolverError, match="2 of 2: Stopped at the iteration limit"):
        batch.raise_if_failed()


@pytest.mark.parametrize("backend", BACKENDS)
def test_warm_starts_of_every_kind(backend: str) -> None:
    starts, numbers = varied()
    done = solve_batch(rope(), starts, numbers, backend=backend)
    again = solve_batch(rope(), starts, numbers, backend=backend, warm_start=done)
    assert again.iterations.tolist() == [0] * BATCH
    assert again.converged.all()
    np.testing.assert_allclose(again.cost, done.cost, rtol=1e-12)
    alone = one_by_one(backend)
    mixed = solve_batch(rope(), starts, numbers, backend=backend, warm_start=[alone[0], None, *alone[2:]])
    assert mixed.iterations.tolist() == [0, done.iterations[1], 0, 0, 0]
    same = solve_batch(rope(), starts, numbers, backend=backend, warm_start=alone[0])
    assert same.iterations[0] == 0
    for i in (0, 3):
        expected = MSiLQR(rope().with_parameters(row(numbers, i)).with_start(starts[i]), backend=backend).solve(
            alone[0]
        )
        assert_row(same, i, expected)


@pytest.mark.parametrize("backend", BACKENDS)
def test_instance_that_fails_does_not_disturb_the_others(backend: str) -> None:
    starts, numbers = varied()
    masses = numbers["rope.mass"].copy()
    masses[2] = 0.0
    batch = solve_batch(rope(), starts, {**numbers, "rope.mass": masses}, backend=backend, threads=1)
    assert batch.status[2] is Status.NOT_FINITE
    assert "implicit dynamics of model 'rope'" in batch.faults[2]
    assert "- instance 2: implicit dynamics" in batch.explain()
    for i in (0, 1, 3, 4):
        assert_row(batch, i, one_by_one(backend)[i])


def test_progress_comes_from_the_calling_thread_and_ends_with_all() -> None:
    told, threads = [], set()

    def note(done: int, total: int) -> None:
        told.append((done, total))
        threads.add(threading.get_ident())

    solve_batch(rope(), *varied(), progress=note)
    assert told[-1] == (BATCH, BATCH)
    assert told == sorted(told)
    assert threads == {threading.get_ident()}


# ---- parameters by name


def test_parameters_of_an_instance_are_those_of_a_declaration_with_them() -> None:
    g = ocp.parameter("g", 9.81)
    drop = ocp.Model("drop", state={"z": 1, "v": 1}, control={"push": 1},
                     modes={"fall": lambda s: {"z": s.v, "v": s.push - g}})  # fmt: skip

    def problem(gravity: float, weight: float, goal: float, ceiling: float, reach: float) -> CompiledProblem:
        limits = ocp.Constraints(
            ocp.inequality(lambda s: s.z, upper=ceiling, name="ceiling"),
            ocp.inequality(near, name="near", parameters={"reach": reach}),
        )
        costs = ocp.Objective(
            ocp.regularize("push", weight), ocp.track("z", 100.0, at="end", to=goal), ocp.track("z", 0.1)
        )
        motion = ocp.Motion(ocp.Phase("go", "fall", 0.3, {"z": 0.2}))
        declared = ocp.Problem(motion, drop.until_end(dt=0.05), costs, limits, initial=[0.0, 0.0])
        return compile_problem(declared.with_parameters(g=gravity))

    def near(s, reach):
        return reach - s.z

    base, other = problem(9.81, 0.1, 0.5, 2.0, 3.0), problem(1.62, 0.2, 0.8, np.inf, 2.5)
    assert base.parameters["g"].tolist() == [9.81]
    assert base.parameters["ceiling.upper"].tolist() == [2.0]
    assert other.parameters["ceiling.upper"].tolist() == [np.inf]
    assert "track z.target" not in base.parameters  # follows the path
    changed = base.with_parameters({
        "g": 1.62, "regularize push.weight": 0.2, "track z at end.target": 0.8, "ceiling.upper": np.inf,
        "near.reach": 2.5,
    })  # fmt: skip
    for a, b in zip(changed.phases, other.phases, strict=True):
        for name in ("p", "p_end", "p_transition", "weight", "g_mask", "h_mask", "end_weight", "end_g_mask"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    alone, by_batch = MSiLQR(other).solve(), solve_batch(base, parameters={
        "g": [1.62], "regularize push.weight": [[0.2]], "track z at end.target": [0.8], "ceiling.upper": [np.inf],
        "near.reach": [2.5],
    })  # fmt: skip
    assert_row(by_batch, 0, alone)


def test_terms_of_one_name_are_told_apart() -> None:
    problem = PROBLEMS["swing up"]()
    objective = ocp.Objective(*problem.objective, ocp.track("angle", 0.25))
    compiled = compile_problem(
        ocp.Problem(problem.motion, problem.schedule, objective, problem.constraints, initial=problem.initial)
    )
    assert compiled.parameters["track angle[0].weight"].tolist() == [0.5]
    assert compiled.parameters["track angle[1].weight"].tolist() == [0.25]
    assert "track angle.weight" not in compiled.parameters
    phase = compiled.with_parameters({"track angle[1].weight": 0.75}).phases[0]
    rows = phase.mode.rows["stage_residual"]
    weights = {compiled.terms[r.term].name + str(r.term): phase.weight[0, j] for j, r in enumerate(rows)}
    assert sorted(v for k, v in weights.items() if k.startswith("track angle")) == [0.5, 0.75]


def test_weight_stays_zero_where_a_term_does_not_apply() -> None:
    compiled = rope()
    ends = [
        phase.end_weight.tolist() for phase in compiled.with_parameters({"track place at end.weight": [1, 2]}).phases
    ]
    assert ends == [[0.0, 0.0], [1.0, 2.0]]


def test_problem_is_left_as_it_was() -> None:
    compiled = rope()
    before = [phase.p.copy() for phase in compiled.phases]
    compiled.with_parameters({"rope.mass": 9.0}).with_start([0.0, 0.0, 0.0, 0.0])
    for phase, p in zip(compiled.phases, before, strict=True):
        np.testing.assert_array_equal(phase.p, p)
    assert compiled.initial.tolist() == [0.2, 0.1, 1.2, 0.0]


# ---- refused before any work

REFUSED = {
    "name": ({"parameters": {"rope.mas": [1.0]}}, UnknownNameError, "did you mean 'rope.mass'"),
    "slot of the motion": (
        {"parameters": {"rope.taut": [1.0]}}, ProblemError, "parameter 'rope.taut': follows from the motion",
    ),
    "columns": (
        {"parameters": {"force limit.upper": [1.0, 2.0]}}, ShapeError,
        "'force limit.upper' has the wrong shape - got (2,), expected (batch, 2)",
    ),
    "rows": (
        {"parameters": {"rope.mass": [1.0, 2.0, 3.0]}}, ShapeError,
        "got {\"parameter 'rope.mass'\": 3, 'initial states': 2}",
    ),
    "states": ({"initial_states": np.zeros((2, 3))}, ShapeError, "got (2, 3), expected (batch, 4)"),
    "nothing": ({"initial_states": None}, ShapeError, "got nothing that varies"),
    "none": ({"initial_states": np.zeros((0, 4))}, ShapeError, "got {'initial states': 0}"),
    "NaN": (
        {"parameters": {"rope.mass": [1.0, np.nan]}}, ProblemError,
        "solve_batch, instance 1, parameter 'rope.mass': is not finite - got nan at entry 0",
    ),
    "infinite weight": (
        {"parameters": {"regularize tension.weight": [np.inf, 1.0]}}, ProblemError, "instance 0, parameter 'regularize",
    ),
    "negative weight": (
        {"parameters": {"regularize tension.weight": [1.0, -1.0]}}, ProblemError, "instance 1, parameter 'regularize",
    ),
    "NaN state": (
        {"initial_states": [[0, 0, 0, 0], [0, 0, np.inf, 0]]}, ProblemError,
        "instance 1: initial state is not finite - got inf at entry 2, 'speed x' of model 'rope'",
    ),
    "bounds": (
        {"parameters": {"tension.lower": [0.0, 70.0]}}, ProblemError,
        "instance 1: constraint 'tension' (problems.py",
    ),
    "warm starts": ({"warm_start": [None] * 3}, ShapeError, "'warm start': 3"),
    "threads": ({"threads": 0}, SolverError, "threads is out of range - got 0"),
    "backend": ({"backend": "fortran"}, SolverError, "backend is unknown"),
    "problem": ({"problem": 3}, SolverError, "not a problem - got int"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_does_not_fit_is_refused_before_any_work(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*arguments: object) -> None:
        raise AssertionError

    monkeypatch.setattr("piaffe.solvers.batch.batch.native_memory", never)
    arguments, kind, told = REFUSED[name]
    with pytest.raises(kind, match=re.escape(told)) as caught:
        solve_batch(**{"problem": rope(), "initial_states": [rope().initial] * 2, **arguments})
    assert isinstance(caught.value, PiaffeError)


def test_warm_start_of_another_problem_is_refused_by_instance() -> None:
    other = MSiLQR(hopper(), Options(max_iterations=1)).solve()
    good = one_by_one("native")[0]
    with pytest.raises(SolverError, match="instance 1: warm start: does not fit the problem"):
        solve_batch(rope(), [rope().initial] * 2, warm_start=[good, other])


# ---- stopping

ENDLESS = Options(max_defect=1e-300, max_inner=10**9, max_iterations=400_000)


@pytest.mark.parametrize("threads", [1, 2])
def test_interruption_returns_the_iterates_so_far(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    if threading.current_thread() is not threading.main_thread():
        pytest.skip("not on the main thread")
    problem = compile_problem(PROBLEMS["swing up"]())

    def press(memory: SolverMemory) -> None:
        while memory.c.num_records < 100:
            time.sleep(0.01)
        _thread.interrupt_main()

    def watched(*arguments: object) -> SolverMemory | None:
        memory = native_memory(*arguments)
        if memory is not None:
            threading.Thread(target=press, args=(memory,), daemon=True).start()
        return memory

    if native_memory(problem, Options()) is None:
        pytest.skip("no compiler")
    monkeypatch.setattr("piaffe.solvers.batch.batch.native_memory", watched)
    batch = solve_batch(problem, [problem.initial] * 6, options=ENDLESS, threads=threads)
    begun = np.array([search is not None for search in batch.search])
    assert 1 <= begun.sum() <= threads
    assert batch.iterations.max() >= 100
    assert set(batch.status) == {Status.INTERRUPTED}
    assert np.isfinite(batch.cost[begun]).all()
    assert np.isnan(batch.cost[~begun]).all()
    assert np.isnan(batch.states[~begun]).all()
    assert np.isfinite(batch.states[begun]).all()
    assert [batch.warm_start(i) is None for i in range(6)] == (~begun).tolist()
    assert "Interrupted" in batch.explain()


@pytest.mark.parametrize("backend", BACKENDS)
def test_interruption_in_the_progress_keeps_the_instances_before(backend: str) -> None:
    def press(done: int, total: int) -> None:
        raise KeyboardInterrupt

    starts, numbers = varied()
    many = {name: np.concatenate([table] * 20) for name, table in numbers.items()}
    batch = solve_batch(rope(), np.concatenate([starts] * 20), many, backend=backend, threads=1, progress=press)
    done = batch.converged
    assert 1 <= done.sum() < 100
    assert done[: done.sum()].all()
    assert_row(batch, 0, one_by_one(backend)[0])
    assert batch.status[-1] is Status.INTERRUPTED


def test_error_in_the_progress_stops_every_thread_before_it_is_raised() -> None:
    def fail(done: int, total: int) -> None:
        raise ZeroDivisionError

    starts = np.repeat(rope().initial[None], 200, axis=0)
    before = threading.active_count()
    with pytest.raises(ZeroDivisionError):
        solve_batch(rope(), starts, threads=2, progress=fail)
    assert threading.active_count() == before


def test_error_in_a_thread_is_raised_in_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("piaffe.solvers.batch.batch.write", fail)
    with pytest.raises(ZeroDivisionError):
        solve_batch(rope(), [rope().initial] * 3, threads=2)
