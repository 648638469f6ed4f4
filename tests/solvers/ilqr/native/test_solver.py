"""The solver in C makes the iterates of the one in NumPy, and stops, fails and repeats itself as it does."""

import _thread
import shutil
import subprocess
import threading
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.codegen import NoCompilerWarning, compilers
from piaffe.codegen.compilers import NoCompilerError
from piaffe.errors import SolverError
from piaffe.models import base, feet, joints, stance
from piaffe.ocp import CompiledProblem, compile_problem
from piaffe.solvers import MSiLQR, Options, Record, Solution, Status
from piaffe.solvers.ilqr.iterate import Iterate
from piaffe.solvers.ilqr.native.backend import Backend, run_native
from piaffe.solvers.ilqr.native.library import library_for
from piaffe.solvers.ilqr.native.memory import SolverMemory
from piaffe.solvers.ilqr.native.program import program
from piaffe.solvers.ilqr.result import assemble
from piaffe.solvers.ilqr.run import Run

from ....problems import PROBLEMS, linear_quadratic, tumbling
from .watched import Watched, same_decisions

GCC = next((path for name in ("gcc", "cc", "clang") if (path := shutil.which(name))), None)
pytestmark = pytest.mark.skipif(GCC is None, reason="no C compiler on the path")

ENDLESS = Options(max_defect=1e-300, max_inner=10**9, max_iterations=400_000)
"""No defect is small enough, so that a solve takes seconds."""


def landing() -> ocp.Problem:
    """Mini Cheetah falls on its feet, at first with all its joints, then as a rigid body."""
    robot = models.load("mini_cheetah")
    body, rigid = models.WholeBody(robot), models.SingleRigidBody(robot)
    motion = ocp.Motion(
        ocp.Phase("fall", stance(""), 0.06, ocp.Keyframe(position=(0, 0, 0.3), joints="stand")),
        ocp.Phase("land", stance("FL FR HL HR"), 0.16, ocp.Keyframe(position=(0, 0, 0.28), joints="stand")),
    )
    objective = ocp.Objective(
        ocp.track(base.position, weight=(1, 1, 30)), ocp.track(base.orientation, weight=2.0),
        ocp.track(base.linear_velocity, weight=1.0), ocp.track(base.angular_velocity, weight=1.0),
        ocp.track(joints.position, weight=1.0), ocp.track(joints.velocity, weight=0.05),
        ocp.regularize(joints.torque, weight=0.02), ocp.regularize(feet.force, weight=1e-4),
    )  # fmt: skip
    limits = ocp.Constraints(
        models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(), models.foot_clearance(minimum=0.0)
    )
    schedule = body.over(0.12, dt=0.01) + rigid.over(0.10, dt=0.05).without(limits)
    return ocp.Problem(motion, schedule, objective, limits, initial=body.state(joints="stand"))


ALL: dict[str, Callable[[], ocp.Problem]] = {"linear-quadratic": linear_quadratic, **PROBLEMS, "landing": landing}


@cache
def compiled(name: str) -> CompiledProblem:
    return compile_problem(ALL[name]())


@cache
def by_numpy(name: str) -> Solution:
    return MSiLQR(compiled(name), backend="numpy").solve()


@cache
def watched(name: str) -> Watched:
    numpy = MSiLQR(compiled(name), backend="numpy")
    run = Watched(numpy.functions, numpy.scaled_options(), numpy.start(None), numpy.flags(True), None)
    assert run.loop() is Status.CONVERGED
    return run


@cache
def native(name: str) -> MSiLQR:
    solver = MSiLQR(compiled(name))
    assert solver.backend == "native"
    return solver


@cache
def in_c(name: str) -> Solution:
    return native(name).solve()


def of_width(problem: CompiledProblem, width: int, options: Options | None = None) -> MSiLQR:
    """Return a solver with a number of lanes."""
    solver = MSiLQR(problem, options, backend="numpy")
    library, _ = library_for(problem, width=width)
    solver.memory = SolverMemory(problem, library, solver.options)
    return solver


def assert_same_records(got: tuple[Record, ...], expected: tuple[Record, ...]) -> None:
    scale = 1 + max((abs(record.cost) for record in expected[-1:]), default=0.0)
    for name in ("cost", "merit", "expected", "max_defect", "max_equality", "max_inequality"):
        a, b = ([getattr(record, name) for record in history] for history in (got, expected))
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-10 * scale, err_msg=name)
    for name in ("iteration", "step_size", "regularization", "barrier_weight"):
        assert [getattr(r, name) for r in got] == [getattr(r, name) for r in expected], name


def assert_equal_states(got: Solution, expected: Iterate) -> None:
    for part, x, u in zip(got.trajectory.phases, expected.states, expected.controls, strict=True):
        np.testing.assert_array_equal(part.states, x)
        np.testing.assert_array_equal(part.controls, u)


def assert_same_history(got: Solution, expected: Solution) -> None:
    assert got.status is expected.status
    assert got.iterations == expected.iterations
    assert_same_records(got.history, expected.history)


def assert_same_result(got: Solution, expected: Solution, rtol: float = 1e-6) -> None:
    def close(a: np.ndarray, b: np.ndarray, what: str) -> None:
        np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol * (1 + np.max(np.abs(b), initial=0.0)), err_msg=what)

    assert got.cost == pytest.approx(expected.cost, rel=rtol)
    for a, b in zip(got.trajectory.phases, expected.trajectory.phases, strict=True):
        close(a.states, b.states, "states")
        close(a.controls, b.controls, "controls")
    for p, q in zip(got.phases, expected.phases, strict=True):
        assert p.multipliers.keys() == q.multipliers.keys()
        for name in p.multipliers:
            close(p.multipliers[name], q.multipliers[name], name)
        for name in ("feedforward", "feedback", "V_x", "V_xx", "Q_u", "Q_uu"):
            close(getattr(p, name), getattr(q, name), name)


def assert_equal_bits(got: Solution, expected: Solution) -> None:
    assert got.status is expected.status
    for a, b in zip(got.history, expected.history, strict=True):
        assert replace(a, wall_s=0.0) == replace(b, wall_s=0.0)
    for a, b in zip(got.trajectory.phases, expected.trajectory.phases, strict=True):
        np.testing.assert_array_equal(a.states, b.states)
        np.testing.assert_array_equal(a.controls, b.controls)
    for p, q in zip(got.phases, expected.phases, strict=True):
        for name in p.multipliers:
            np.testing.assert_array_equal(p.multipliers[name], q.multipliers[name])


# ---- the same iterates


@pytest.mark.parametrize("name", ALL)
def test_history_is_that_of_numpy_except_for_decisions_within_rounding(name: str) -> None:
    run = watched(name)
    common = same_decisions(in_c(name).history, tuple(run.history))
    if common < max(len(run.history), in_c(name).iterations):
        assert min(run.margins[: common + 1]) < 1e-8
    else:
        assert in_c(name).status is Status.CONVERGED
    assert_same_records(in_c(name).history[:common], tuple(run.history[:common]))


@pytest.mark.parametrize("name", ALL)
def test_from_each_iterate_of_numpy_one_iteration_makes_the_next(name: str) -> None:
    """The state goes over as a warm start: iterate, multipliers, barrier and all that a search keeps."""
    run, one = watched(name), Options(max_iterations=1)
    numpy, compiled_solver = (MSiLQR(compiled(name), one, backend=backend) for backend in ("numpy", "native"))
    before: Solution | None = None
    for k, iterate in enumerate(run.iterates):
        after, got = numpy.solve(before), compiled_solver.solve(before)
        assert_equal_states(after, iterate)
        if same_decisions(got.history, after.history) == 1:
            assert_same_records(got.history, after.history)
            for part, x, u in zip(got.trajectory.phases, iterate.states, iterate.controls, strict=True):
                np.testing.assert_allclose(part.states, x, rtol=1e-8, atol=1e-8 * np.max(np.abs(x)))
                np.testing.assert_allclose(part.controls, u, rtol=1e-8, atol=1e-8 * np.max(np.abs(u), initial=1.0))
        else:
            assert run.margins[k] < 1e-8
        if got.status is not after.status:
            assert min(run.margins[k : k + 2]) < 1e-8
        before = after
    assert before is not None
    assert before.status is Status.CONVERGED


@pytest.mark.parametrize("name", ALL)
def test_solution_and_duals_are_those_of_numpy(name: str) -> None:
    assert_same_result(in_c(name), by_numpy(name))


@pytest.mark.parametrize("limit", [1, 3, 200])
@pytest.mark.parametrize("name", ALL)
def test_policy_and_expansions_are_those_of_numpy_at_the_same_iterate(name: str, limit: int) -> None:
    assert_same_policy(compiled(name), limit)


@pytest.mark.parametrize("limit", [1, 2])
def test_policy_and_step_of_a_body_that_turns_fast_in_midpoint_steps_is_that_of_numpy(limit: int) -> None:
    body, every = models.SingleRigidBody(models.load("mini_cheetah")), stance("FL FR HL HR")
    objective = ocp.Objective(
        ocp.track(base.position, weight=5.0), ocp.track(base.orientation, weight=(3.0, 1.0, 2.0)),
        ocp.regularize(base.angular_velocity, weight=0.1), ocp.regularize(feet.force, weight=1e-3),
    )  # fmt: skip
    motion = ocp.Motion(ocp.Phase("push", every, 0.2), ocp.Phase("fly", stance(""), 0.2))
    start = body.state(rpy=(0.3, -0.4, 0.5), linear_velocity=(0.3, 0.2, 1.0), angular_velocity=(6.0, -5.0, 8.0))
    problem = compile_problem(ocp.Problem(motion, body.until_end(dt=0.05), objective, initial=start))
    assert_same_policy(problem, limit)
    a, b = (MSiLQR(problem, Options(max_iterations=limit), backend=backend).solve() for backend in ("native", "numpy"))
    assert_same_history(a, b)
    assert_same_result(a, b)


def assert_same_policy(problem: CompiledProblem, limit: int) -> None:
    """Compare the last sweep of the compiled solver with that of NumPy at the same iterate."""
    by_c = MSiLQR(problem, Options(max_iterations=limit))
    assert by_c.memory is not None
    run = Run(by_c.functions, by_c.scaled_options(), by_c.start(None), by_c.flags(True), None)
    status = run_native(by_c.memory, run, None, None)
    assert run.policy is not None
    got = assemble(run, status, 0.0)
    run.policy = None
    expected = assemble(run, status, 0.0)
    for p, q in zip(got.phases, expected.phases, strict=True):
        for field in ("feedforward", "feedback", "V_x", "V_xx", "Q_x", "Q_u", "Q_xx", "Q_ux", "Q_uu"):
            a, b = getattr(p, field), getattr(q, field)
            close = 1e-8 * (1 + np.max(np.abs(b), initial=0.0))
            np.testing.assert_allclose(a, b, rtol=1e-8, atol=close, err_msg=field)


def test_policy_is_zero_where_no_sweep_succeeds() -> None:
    problem, options = compiled("hopper"), Options(max_iterations=1)
    solver = MSiLQR(problem, options)
    assert solver.memory is not None
    solver.solve()
    solver.memory.c.options.max_regularization = -1.0
    for sweep in solver.memory.policy():
        assert sweep.V_xx.shape[0] == len(sweep.feedback) + 1
        assert not any(np.any(getattr(sweep, field.name)) for field in fields(sweep))


@pytest.mark.parametrize("name", ["hopper", "rope"])
def test_warm_start_goes_on_from_the_duals_as_numpy_does(name: str) -> None:
    problem, options = compiled(name), Options(barrier_gap=1e-6, max_equality=1e-7, max_inequality=1e-7)
    half = MSiLQR(problem, Options(max_iterations=12), backend="numpy").solve()
    assert half.status is Status.ITERATION_LIMIT
    a, b = (MSiLQR(problem, options, backend=backend).solve(half) for backend in ("native", "numpy"))
    assert a.iterations > 3
    assert_same_history(a, b)
    assert_same_result(a, b)


@pytest.mark.parametrize("backend", ["native", "numpy"])
@pytest.mark.parametrize("name", ALL)
def test_solution_as_its_own_warm_start_is_converged(name: str, backend: Backend) -> None:
    done = in_c(name) if backend == "native" else by_numpy(name)
    again = MSiLQR(compiled(name), backend=backend).solve(done)
    assert again.status is Status.CONVERGED
    assert again.iterations == 0
    assert_same_result(again, done, rtol=1e-9)


@pytest.mark.parametrize("backend", ["native", "numpy"])
@pytest.mark.parametrize("name", ["hopper", "rope", "landing"])
def test_solve_in_two_parts_is_the_solve_in_one(name: str, backend: Backend) -> None:
    whole = in_c(name) if backend == "native" else by_numpy(name)
    for stop in (1, 7, whole.iterations - 3):
        first = MSiLQR(compiled(name), Options(max_iterations=stop), backend=backend).solve()
        rest = MSiLQR(compiled(name), backend=backend).solve(first)
        counted_on = tuple(replace(record, iteration=record.iteration + stop) for record in rest.history)
        assert_same_records(counted_on, whole.history[stop:])
        assert rest.status is Status.CONVERGED


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_search_of_another_problem_is_forgotten(backend: Backend) -> None:
    problem = compiled("hopper")
    moved = replace(problem, initial=problem.initial + np.array([0.0, 0.01, 0.0, 0.0, 0.0]))
    warm = in_c("hopper")
    a, b = (MSiLQR(moved, backend=backend).solve(start) for start in (warm, replace(warm, search=None)))
    assert a.iterations > 0
    assert_equal_bits(a, b)


@pytest.mark.parametrize("width", [1, 2, 4, 8])
@pytest.mark.parametrize("name", ["flying body", "rope"])
def test_vector_width_changes_nothing(name: str, width: int) -> None:
    solution = of_width(compiled(name), width).solve()
    assert_same_history(solution, by_numpy(name))
    assert_same_result(solution, by_numpy(name))


@pytest.mark.parametrize("width", [1, 4, 8])
def test_nodes_of_one_block_may_have_different_time_steps(width: int) -> None:
    """One stage of 1 ms and six of 0.1 s share functions and blocks; their rows weigh by their own time steps."""
    ball = ocp.Model(
        "ball", state={"z": 1, "vz": 1}, control={"thrust": 1},
        modes={"fall": lambda s: {"z": s.vz, "vz": s.thrust - 9.81}},
    )  # fmt: skip
    motion = ocp.Motion(ocp.Phase("wait", "fall", 0.001), ocp.Phase("rise", "fall", 0.6, {"z": 1.5}))
    objective = ocp.Objective(ocp.track("z", 2000.0, at="end"), ocp.regularize("thrust", 1e-3))
    limits = ocp.Constraints(ocp.inequality(lambda s: s.thrust, lower=-1.0, upper=16.0, name="thrust", unit="N"))
    problem = compile_problem(
        ocp.Problem(motion, ball.over(0.001, dt=0.001) + ball.over(0.6, dt=0.1), objective, limits, initial=[1.0, 0.0])
    )
    for inner in (1, 5):
        options = Options(max_inner=inner)
        solution = of_width(problem, width, options).solve()
        assert_same_history(solution, MSiLQR(problem, options, backend="numpy").solve())
        assert solution.status is Status.CONVERGED


def test_first_step_from_a_large_defect_at_a_reset_that_turns_is_that_of_numpy() -> None:
    problem = compile_problem(tumbling())
    rng, one = np.random.default_rng(0), Options(max_iterations=1)
    begun = MSiLQR(problem, one, backend="numpy").solve()
    parts = tuple(
        replace(part, states=phase.mode.state.np_plus(part.states, rng.normal(scale=0.5, size=(len(part.states), 6))))
        for phase, part in zip(problem.phases, begun.trajectory.phases, strict=True)
    )
    far = replace(begun, trajectory=replace(begun.trajectory, phases=parts))
    a, b = (MSiLQR(problem, one, backend=backend).solve(far) for backend in ("native", "numpy"))
    assert a.iterations == 1
    assert_same_history(a, b)
    assert_same_result(a, b)


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_state_of_the_search_is_handed_over_as_it_was(backend: Backend) -> None:
    """A solve that is out of time at once has changed nothing of what it was given."""
    problem = compiled("swing up")
    part = MSiLQR(problem, Options(max_iterations=6, max_inner=100), backend=backend).solve()
    assert part.search is not None
    assert len(part.search.gains) >= 2
    again = MSiLQR(problem, Options(time_limit_s=1e-12, max_inner=100), backend=backend).solve(part)
    assert again.status is Status.TIME_LIMIT
    assert again.search == part.search


# ---- determinism


def test_equal_input_gives_equal_bits() -> None:
    assert_equal_bits(native("landing").solve(), in_c("landing"))
    assert_equal_bits(MSiLQR(compiled("landing")).solve(), in_c("landing"))


def test_solver_keeps_nothing_of_an_earlier_solve() -> None:
    solver = MSiLQR(compiled("hopper"))
    warm = solver.solve(in_c("hopper"))
    assert warm.iterations < in_c("hopper").iterations
    assert_equal_bits(solver.solve(), in_c("hopper"))


def test_problems_in_threads_do_not_disturb_one_another() -> None:
    hopper = compiled("hopper")
    problems = [hopper, replace(hopper, initial=hopper.initial * 1.01), compiled("rope")]
    alone = [MSiLQR(problem).solve() for problem in problems]
    barrier = threading.Barrier(len(problems))

    def repeatedly(problem: CompiledProblem) -> list[Solution]:
        solver = MSiLQR(problem)
        barrier.wait()
        return [solver.solve() for _ in range(5)]

    with ThreadPoolExecutor(len(problems)) as pool:
        for expected, solutions in zip(alone, pool.map(repeatedly, problems), strict=True):
            for solution in solutions:
                assert_equal_bits(solution, expected)
    assert alone[0].cost != alone[1].cost


def test_second_solve_of_one_object_in_another_thread_is_refused() -> None:
    solver, inside, leave = MSiLQR(compiled("hopper")), threading.Event(), threading.Event()

    def wait(record: Record) -> None:
        inside.set()
        leave.wait(30)

    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(solver.solve, progress=wait)
        assert inside.wait(30)
        with pytest.raises(SolverError, match="a solve is running - got a second call"):
            solver.solve()
        leave.set()
        assert_equal_bits(first.result(), in_c("hopper"))
    assert_equal_bits(solver.solve(), in_c("hopper"))


# ---- memory


@pytest.mark.skipif(shutil.which("nm") is None, reason="no nm")
def test_compiled_solver_cannot_allocate() -> None:
    library, _ = library_for(compiled("landing"))
    listed = subprocess.run(
        ["nm", "-D", "--undefined-only", str(library.built.path)], capture_output=True, text=True, check=True
    ).stdout
    names = {line.split()[-1].split("@")[0] for line in listed.splitlines()}
    assert "clock_gettime" in names  # it is read right
    for name in names:
        assert not any(part in name for part in ("alloc", "free", "_Znw", "mmap", "brk", "memalign", "strdup")), name


# ---- stopping


def test_progress_gets_every_record_in_order() -> None:
    told: list[Record] = []
    solution = native("swing up").solve(progress=told.append)
    assert tuple(told) == solution.history
    assert [record.iteration for record in told] == list(range(1, len(told) + 1))


def test_iteration_limit_is_that_of_numpy() -> None:
    for limit in (1, 7):
        a, b = (
            MSiLQR(compiled("rope"), Options(max_iterations=limit), backend=backend).solve()
            for backend in ("native", "numpy")
        )
        assert a.status is Status.ITERATION_LIMIT
        assert a.iterations == limit
        assert_same_history(a, b)
        assert_same_result(a, b)


def test_time_limit_stops_the_solve() -> None:
    began = time.perf_counter()
    solution = MSiLQR(compiled("swing up"), replace(ENDLESS, time_limit_s=0.1)).solve()
    assert solution.status is Status.TIME_LIMIT
    assert time.perf_counter() - began < 5
    assert solution.iterations > 0
    assert solution.history[-1].cost == pytest.approx(solution.cost, rel=1e-9)
    assert MSiLQR(compiled("swing up"), Options(time_limit_s=1e-9)).solve().iterations == 0


@pytest.fixture
def endless() -> MSiLQR:
    return MSiLQR(compiled("swing up"), ENDLESS)


def assert_stopped(solver: MSiLQR) -> None:
    assert solver.memory is not None
    count = solver.memory.c.num_records
    time.sleep(0.02)
    assert solver.memory.c.num_records == count
    assert count < ENDLESS.max_iterations


def test_interruption_from_the_keyboard_returns_the_iterate(endless: MSiLQR) -> None:
    if threading.current_thread() is not threading.main_thread():
        pytest.skip("not on the main thread")
    timer = threading.Timer(0.1, _thread.interrupt_main)
    timer.start()
    solution = endless.solve()
    timer.join()
    assert solution.status is Status.INTERRUPTED
    assert_stopped(endless)
    assert solution.iterations > 0
    assert solution.cost == pytest.approx(solution.history[-1].cost, rel=1e-9)


def test_interruption_in_the_progress_returns_the_iterate(endless: MSiLQR) -> None:
    def press(record: Record) -> None:
        raise KeyboardInterrupt

    solution = endless.solve(progress=press)
    assert solution.status is Status.INTERRUPTED
    assert_stopped(endless)
    assert solution.cost == pytest.approx(solution.history[-1].cost, rel=1e-9)


def test_error_in_the_progress_stops_the_solver_before_it_is_raised(endless: MSiLQR) -> None:
    def fail(record: Record) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        endless.solve(progress=fail)
    assert_stopped(endless)
    assert endless.solve(progress=lambda record: _thread.interrupt_main()).status is Status.INTERRUPTED


def test_solve_can_be_cancelled_from_elsewhere(endless: MSiLQR) -> None:
    memory = endless.memory
    assert memory is not None
    solution = endless.solve(progress=lambda record: setattr(memory.c, "cancel", 1))
    assert solution.status is Status.INTERRUPTED
    assert_stopped(endless)


# ---- compilers


@pytest.mark.parametrize(
    ("name", "width"),
    [("rope", 1), ("rope", 2), ("rope", 4), ("rope", 8), ("linear-quadratic", 8), ("flying body", 1)],
)
def test_templates_compile_without_a_warning(name: str, width: int, tmp_path: Path) -> None:
    library, _ = library_for(compiled(name))
    sources = program(library.modes, library.transitions)
    for file, text in sources.headers.items():
        (tmp_path / file).write_text(text)
    files = []
    for unit, text in sources.kernels:
        (tmp_path / f"{unit}.c").write_text(text)
        files.append(f"{unit}.c")
    flags = ["-std=gnu11", "-Wall", "-Wextra", "-Werror", "-Wno-psabi", f"-DPIAFFE_W={width}", "-O1", "-fPIC", "-c"]
    done = subprocess.run([str(GCC), *flags, *files], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:3000]


def test_without_a_compiler_it_says_so_and_solves_in_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = compile_problem(ALL["bouncing ball"]())  # afresh: its library is not loaded yet

    def none() -> None:
        raise NoCompilerError("native backend: no C compiler - got none, expected cc; install one")

    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(compilers, "find_spec", lambda name: None)
    monkeypatch.setattr(compilers, "_NAMES", ())
    with pytest.warns(NoCompilerWarning, match="no C compiler") as caught:
        solver = MSiLQR(problem)
    assert len(caught) == 1
    assert solver.backend == "numpy"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_equal_bits(solver.solve(), by_numpy("bouncing ball"))
