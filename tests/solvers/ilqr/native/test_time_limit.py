"""The time limit with a clock that counts how often it is asked: solves stop between two trials, too."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from piaffe.codegen import SOLVER_FLAGS, build, load
from piaffe.ocp import CompiledProblem, compile_problem
from piaffe.solvers import MSiLQR, Options, Solution, Status
from piaffe.solvers.ilqr import run as numpy_run
from piaffe.solvers.ilqr.native import Backend, SolverMemory
from piaffe.solvers.ilqr.native.library import library_for
from piaffe.solvers.ilqr.native.program import program

from ....problems import PROBLEMS
from .test_solver import pytestmark as needs_compiler

pytestmark = needs_compiler
BACKENDS = pytest.mark.parametrize("backend", ["native", "numpy"])
COUNTING = """
#include <time.h>
int counting_clock(clockid_t id, struct timespec *t)
{
    static _Thread_local long asked;
    (void)id;
    *t = (struct timespec){++asked, 0};
    return 0;
}
"""
NAME = "swing up"  # line searches with several trials, and corrections
LONG = 45


@cache
def compiled() -> CompiledProblem:
    return compile_problem(PROBLEMS[NAME]())


@cache
def counting() -> SolverMemory:
    """Return the memory of a compiled solver with such a clock."""
    library, _ = library_for(compiled())
    made = program(library.modes, library.transitions)
    units = [*made.expressions, *made.kernels, ("counting", COUNTING)]
    flags = (*SOLVER_FLAGS, "-Dclock_gettime=counting_clock")
    built = build(units, headers=made.headers, flags=flags, width=library.built.width, label="a solver for tests")
    return SolverMemory(compiled(), replace(library, loaded=load(built), built=built), Options())


def solve(backend: Backend, options: Options, monkeypatch: pytest.MonkeyPatch) -> Solution:
    """Solve with a clock that is one second later whenever it is asked: once per trial, and once per record."""
    solver = MSiLQR(compiled(), options, backend="numpy")
    if backend == "native":
        solver.memory = counting()
        solver.memory.c.options.time_limit_s = options.time_limit_s or 0.0
        solver.memory.c.options.max_iterations = options.max_iterations
        return solver.solve()
    asked = iter(range(10**6))
    with monkeypatch.context() as patch:
        patch.setattr(numpy_run, "time", SimpleNamespace(perf_counter=lambda: float(next(asked))))
        return solver.solve()


@BACKENDS
def test_solve_stops_before_the_trial_that_would_be_late(backend: Backend, monkeypatch: pytest.MonkeyPatch) -> None:
    """The iterate, and the state of the search, are those after the last finished iteration."""
    whole = solve(backend, Options(time_limit_s=1e6), monkeypatch)
    ends = [round(record.wall_s) for record in whole.history]  # how often the clock was asked until then
    assert np.sum(np.diff(ends[: LONG // 3]) > 2) >= 3  # iterations of several trials
    for limit in range(LONG):
        solution = solve(backend, Options(time_limit_s=limit + 0.5), monkeypatch)
        assert solution.status is Status.TIME_LIMIT
        finished = sum(end <= limit for end in ends)
        late = finished < len(ends) and ends[finished] == limit + 1  # the last question is that of the record
        assert solution.iterations == finished + late
        other = solve(backend, Options(max_iterations=max(solution.iterations, 1)), monkeypatch)
        assert [replace(r, wall_s=0.0) for r in solution.history] == [
            replace(r, wall_s=0.0) for r in other.history[: solution.iterations]
        ]
        if solution.iterations:
            np.testing.assert_array_equal(solution.states, other.states)
            np.testing.assert_array_equal(solution.controls, other.controls)
            for name in ("rho", "least_rho", "step_size"):
                assert getattr(solution.search, name) == getattr(other.search, name)


def test_both_backends_stop_at_the_same_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    for limit in range(LONG):
        options = Options(time_limit_s=limit + 0.5)
        a, b = (solve(backend, options, monkeypatch) for backend in ("native", "numpy"))
        assert a.iterations == b.iterations
        np.testing.assert_allclose([r.merit for r in a.history], [r.merit for r in b.history], rtol=1e-8)


@BACKENDS
def test_stopped_solve_goes_on_as_if_it_had_not_stopped(backend: Backend, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = MSiLQR(compiled(), backend=backend).solve()
    for limit in range(0, LONG, 4):
        part = solve(backend, Options(time_limit_s=limit + 0.5), monkeypatch)
        rest = MSiLQR(compiled(), backend=backend).solve(part)
        assert rest.status is Status.CONVERGED
        assert part.iterations + rest.iterations == whole.iterations
        assert rest.cost == pytest.approx(whole.cost, rel=1e-9)
