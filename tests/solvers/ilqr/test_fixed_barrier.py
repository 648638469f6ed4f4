"""A solve that keeps its barrier: what it minimises, what it leaves as it was, and how it ends."""

import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import SolverError
from piaffe.ocp import compile_problem
from piaffe.solvers import Fixed, MSiLQR, Options, Solution, Status
from piaffe.solvers.ilqr.native import Backend

from ...problems import LIMIT, PROBLEMS, WEIGHT, WISH, pulling

BACKENDS = pytest.mark.parametrize("backend", ["native", "numpy"])
KEPT = ("equality", "end_equality", "penalty", "end_penalty", "relaxation", "end_relaxation", "shift", "end_shift")


def solved(name: str, backend: Backend, options: Options, warm_start: Solution | None = None) -> Solution:
    return MSiLQR(compile_problem(PROBLEMS[name]()), options, backend=backend).solve(warm_start)


@BACKENDS
@pytest.mark.parametrize(("weight", "relaxation"), [(0.1, 0.1), (2.0, 0.3), (1e-3, 1.0), (5.0, 0.01)])
def test_minimum_is_that_of_cost_and_relaxed_barrier(weight: float, relaxation: float, backend: Backend) -> None:
    """w (u − a) + ε/g = 0 with g = b − u in the logarithm, w (u − a) = ε (g − 2δ)/δ² in the parabola."""
    options = Fixed(weight, relaxation).options(Options(cost_tolerance=1e-14))
    solution = MSiLQR(pulling(), options, backend=backend).solve()
    roots = np.roots([-WEIGHT, WEIGHT * (LIMIT + WISH), weight - WEIGHT * WISH * LIMIT])
    inside = [u for u in roots if LIMIT - u > relaxation]
    in_parabola = WEIGHT + weight / relaxation**2, WEIGHT * WISH + weight * (LIMIT - 2 * relaxation) / relaxation**2
    expected = inside[0] if inside else in_parabola[1] / in_parabola[0]
    np.testing.assert_allclose(solution.controls, expected, rtol=1e-6)
    assert solution.status is Status.STATIONARY
    assert not solution.converged


@BACKENDS
@pytest.mark.parametrize("name", ["hopper", "rope", "flying body"])
def test_barrier_and_multipliers_stay_as_they_are_at_the_start(name: str, backend: Backend) -> None:
    fixed = Fixed(0.02, 0.05)
    first = solved(name, backend, fixed.options())
    assert first.status is Status.STATIONARY
    assert {record.barrier_weight for record in first.history} == {0.02}
    for phase in first.phases:
        for kind, value in (("equality", 0.0), ("penalty", 200.0), ("relaxation", 0.05), ("shift", 0.0)):
            assert np.all(phase.multipliers[kind] == value)
            assert np.all(phase.multipliers[f"end_{kind}"] == value)
    assert max(first.max_equality, first.max_inequality) > 1e-4  # which is why it has not converged
    part = solved(name, backend, Options(max_iterations=9))
    then = solved(name, backend, fixed.options(), part)
    assert then.status is Status.STATIONARY
    assert {record.barrier_weight for record in then.history} <= {part.barrier_weight}
    for before, after in zip(part.phases, then.phases, strict=True):
        for kind in KEPT:
            np.testing.assert_array_equal(after.multipliers[kind], before.multipliers[kind])


@pytest.mark.parametrize("name", ["hopper", "rope", "flying body", "swing up"])
def test_both_backends_make_the_same_iterates(name: str) -> None:
    a, b = (solved(name, backend, Fixed(0.02, 0.05).options()) for backend in ("native", "numpy"))
    assert a.status is b.status is Status.STATIONARY
    assert a.iterations == b.iterations
    np.testing.assert_allclose([r.merit for r in a.history], [r.merit for r in b.history], rtol=1e-8)
    assert [r.step_size for r in a.history] == [r.step_size for r in b.history]


@BACKENDS
def test_stationary_solution_stays_where_it_is_and_adapts_when_it_may(backend: Backend) -> None:
    fixed = solved("hopper", backend, Fixed(0.02, 0.05).options())
    again = solved("hopper", backend, Options(adapt=False), fixed)
    assert again.status is Status.STATIONARY
    assert again.iterations == 0
    rest = solved("hopper", backend, Options(), fixed)
    assert rest.status is Status.CONVERGED
    assert rest.iterations > 0
    assert rest.barrier_weight < 0.02
    assert rest.cost == pytest.approx(solved("hopper", backend, Options()).cost, rel=1e-4)


@BACKENDS
def test_a_converged_solution_is_converged_with_its_own_barrier(backend: Backend) -> None:
    done = solved("hopper", backend, Options())
    assert solved("hopper", backend, Options(adapt=False), done).status is Status.CONVERGED


@BACKENDS
def test_problem_without_rows_converges(backend: Backend) -> None:
    model = ocp.Model("drift", state={"x": 1}, control={"pull": 1}, modes={"go": lambda s: {"x": s.pull}})
    wish = ocp.Objective(ocp.track("pull", WEIGHT, to=WISH))
    problem = ocp.Problem(ocp.Motion(ocp.Phase("go", "go", 0.5)), model.until_end(dt=0.1), wish, initial=[0.0])
    assert MSiLQR(problem, Fixed(0.1, 0.1).options(), backend=backend).solve().status is Status.CONVERGED


@pytest.mark.parametrize(
    ("weight", "relaxation", "message"),
    [
        (0.0, 0.1, "fixed barrier: weight is out of range - got 0.0, expected a positive number; increase it"),
        (0.1, -1.0, "fixed barrier: relaxation is out of range - got -1.0, expected a positive number; increase it"),
    ],
)
def test_numbers_are_checked(weight: float, relaxation: float, message: str) -> None:
    with pytest.raises(SolverError, match=message):
        Fixed(weight, relaxation)


def test_options_are_the_others_with_this_barrier() -> None:
    options = Fixed(0.3, 0.2).options(Options(max_iterations=4))
    assert options == Options(max_iterations=4, barrier_weight=0.3, relaxation=0.2, adapt=False)
